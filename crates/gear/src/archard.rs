//! Wear of both flanks by Archard's law, Eq. (22), in steps that follow the changing flanks.
//!
//! A point of the flanks under the pressure p that slides by v dφ₁ loses K/H · p v dφ₁, on both flanks
//! ([`super::contact_band`]). On involutes the contact band sweeps the flank, so a point loses k · p̄ · 2a |1
//! − u_j/u_i| per mesh: the single-point observation of Flodin and Andersson (Wear 207, 1997). Summing over
//! the rotations remains valid if wear makes the contact dwell or a tip edge carry load.
//!
//! Forces and gaps are recomputed at every step of wear (Ding and Kahraman, J. Sound Vib. 307, 2007), with
//! the contact rule of the pair.

use super::contact_band::{ContactBand, Rubbing, alpha_rad, arc_mm};
use super::contact_load::contact_loads;
use super::error::at_least;
use super::flank_wear::WearProfile;
use super::tooth_outline::ToothOutline;
use super::wear_table::DepthCurve;
use super::{ContactRule, ElasticBodies, Flank, FlankWear, GearError, GearPair};

/// Number of cells of each flank's active profile, of equal arc length.
const CELLS: usize = 64;
/// Largest change of any depth in modules before forces and gaps are recomputed: 2.5 µm at module 6 mm. A
/// step of a fifth of it changes no depth between root and tip by more than 3 % of the greatest.
pub(super) const STEP_MODULES: f64 = 2.5e-3 / 6.0;
/// The same for comparisons of many wear histories. The depths differ by a few per cent.
pub(super) const COARSE_STEP_MODULES: f64 = 5e-3 / 6.0;
/// Number of points per cell at which the contact pressure is computed.
const POINTS_PER_CELL: f64 = 2.0;
/// Largest number of steps of one wear history.
const MAX_STEPS: usize = 20_000;

/// Flanks worn by Archard's law, and the number of turns it took.
#[derive(Debug, Clone, PartialEq)]
pub struct ArchardWear {
    /// Both flanks.
    pub wear: FlankWear,
    /// Turns of the driving gear: load cycles of each of its teeth. Those of the driven gear are z₁/z₂ times
    /// as many.
    pub driving_turns: f64,
}

impl ArchardWear {
    /// Returns the states of one wear history at which the greatest depth of both flanks, along Y, reaches
    /// each of the ascending `depths_mm`, with forces and gaps recomputed after every `step_modules` of wear.
    ///
    /// # Errors
    /// [`GearError::Field`] for depths that do not ascend from 0, or leave less than half of the tooth;
    /// [`GearError::NoContact`] if the worn flanks no longer carry load over the whole mesh period.
    pub(super) fn at_depths(
        pair: &GearPair,
        depths_mm: &[f64],
        step_modules: f64,
    ) -> Result<Vec<Self>, GearError> {
        let mut history = WearHistory::new(pair, step_modules)?;
        let mut min_mm = 0.0;
        let mut states = Vec::with_capacity(depths_mm.len());
        for depth_mm in depths_mm {
            at_least("wear depth in mm", *depth_mm, min_mm)?;
            min_mm = *depth_mm;
            history.advance_to(Target::Depth(*depth_mm))?;
            states.push(history.state());
        }
        Ok(states)
    }

    /// Returns the flanks after a number of turns of the driving gear.
    ///
    /// # Errors
    /// As for the states at given depths; [`GearError::Field`] for turns below 0 or so many that the teeth
    /// are worn through.
    pub fn after_turns(pair: &GearPair, driving_turns: f64) -> Result<Self, GearError> {
        at_least("turns", driving_turns, 0.0)?;
        let mut history = WearHistory::new(pair, STEP_MODULES)?;
        history.advance_to(Target::Turns(driving_turns))?;
        Ok(history.state())
    }
}

/// Target of a part of the history.
#[derive(Debug, Clone, Copy)]
enum Target {
    Depth(f64),
    Turns(f64),
}

/// The active profile of one gear in cells.
#[derive(Debug, Clone)]
struct FlankCells {
    /// Arc length and α₁ at the cells' middles: the outer ends of the first and last cell lie half a cell
    /// beyond start of active profile and tip.
    arcs_mm: Vec<f64>,
    alphas_rad: Vec<f64>,
    radii_mm: Vec<f64>,
    /// Depth along Y.
    depths_mm: Vec<f64>,
    cell_mm: f64,
    /// k = K/H in mm²/N times meshes of a tooth in a turn of the driving gear.
    wear_mm2_per_n: f64,
}

/// A wear history in progress.
struct WearHistory<'a> {
    pair: &'a GearPair,
    bodies: Option<ElasticBodies>,
    outlines: [ToothOutline; 2],
    flanks: [FlankCells; 2],
    driving_turns: f64,
    step_mm: f64,
}

impl FlankCells {
    fn new(pair: &GearPair, i: usize) -> Self {
        let gear = &pair.gears[i];
        let (start, end) = (arc_mm(gear, gear.root_angle_rad), arc_mm(gear, gear.tip_angle_rad));
        let cell_mm = (end - start) / CELLS as f64;
        let arcs_mm: Vec<f64> = (0..=CELLS).map(|cell| start + cell as f64 * cell_mm).collect();
        let alphas_rad: Vec<f64> = arcs_mm.iter().map(|arc| alpha_rad(gear, *arc)).collect();
        let spec = &pair.spec.wear;
        let meshes = f64::from(pair.gears[0].teeth) / f64::from(gear.teeth);
        Self {
            radii_mm: alphas_rad
                .iter()
                .map(|alpha| gear.base_radius_mm * 1.0_f64.hypot(alpha + gear.base_half_angle_rad))
                .collect(),
            alphas_rad,
            depths_mm: vec![0.0; arcs_mm.len()],
            arcs_mm,
            cell_mm,
            wear_mm2_per_n: spec.coefficient / spec.hardness_pa[i] * 1e6 * meshes,
        }
    }

    /// Returns the growth of the depth along the flank's normal in mm per turn of the driving gear. Wear
    /// below the start of active profile is not simulated: the depth there is that of its start.
    fn normal_rates(&self, rubbings: &[Rubbing], i: usize) -> Vec<f64> {
        let last = self.arcs_mm.len() - 1;
        let mut rates = vec![0.0; last + 1];
        for rubbing in rubbings {
            let place = (rubbing.arcs_mm[i] - self.arcs_mm[0]) / self.cell_mm;
            if place < 0.0 {
                continue;
            }
            let before = (place as usize).min(last - 1);
            let part = (place - before as f64).min(1.0);
            let area = self.wear_mm2_per_n * rubbing.work_n;
            rates[before] += area * (1.0 - part);
            rates[before + 1] += area * part;
        }
        // The flank's ends cut the end cells in half.
        for (cell, rate) in rates.iter_mut().enumerate() {
            *rate /= if cell == 0 || cell == last { 0.5 } else { 1.0 } * self.cell_mm;
        }
        rates
    }

    fn deepest_mm(&self) -> f64 {
        self.depths_mm.iter().copied().fold(0.0, f64::max)
    }
}

impl<'a> WearHistory<'a> {
    fn new(pair: &'a GearPair, step_modules: f64) -> Result<Self, GearError> {
        // The deflection of the teeth changes little with their wear, so the bodies of the unworn gears are
        // used.
        let bodies = match pair.spec.dynamics.contact {
            ContactRule::Loaded => Some(ElasticBodies::new(pair, &FlankWear::none())?),
            ContactRule::Threshold => None,
        };
        Ok(Self {
            pair,
            bodies,
            outlines: [0, 1].map(|i| ToothOutline::new(pair, i)),
            flanks: [0, 1].map(|i| FlankCells::new(pair, i)),
            driving_turns: 0.0,
            step_mm: step_modules * pair.spec.geometry.module_mm,
        })
    }

    fn wear(&self) -> FlankWear {
        let profile = |flank: &FlankCells| {
            let points: Vec<(f64, f64)> =
                flank.radii_mm.iter().copied().zip(flank.depths_mm.iter().copied()).collect();
            WearProfile::Table(DepthCurve::new(&points))
        };
        if self.deepest_mm() > 0.0 {
            FlankWear::new(self.flanks.each_ref().map(profile))
        } else {
            FlankWear::none()
        }
    }

    fn state(&self) -> ArchardWear {
        ArchardWear { wear: self.wear(), driving_turns: self.driving_turns }
    }

    fn deepest_mm(&self) -> f64 {
        self.flanks.iter().map(FlankCells::deepest_mm).fold(0.0, f64::max)
    }

    /// Returns the wear work of both flanks per turn of the driving gear; the wear is k times that.
    fn rubbings(&self, wear: &FlankWear) -> Result<Vec<Rubbing>, GearError> {
        let loads = contact_loads(self.pair, wear, self.bodies.as_ref())?;
        let band = ContactBand::new(
            self.pair,
            wear,
            &self.outlines,
            self.flanks[0].cell_mm / POINTS_PER_CELL,
            self.step_mm,
        );
        let mut rubbings = Vec::new();
        for load in &loads {
            band.rub(load, &mut rubbings);
        }
        Ok(rubbings)
    }

    /// Returns the growth of the depths along Y in mm per turn of the driving gear.
    fn rates(&self) -> Result<[Vec<f64>; 2], GearError> {
        let wear = self.wear();
        let rubbings = self.rubbings(&wear)?;
        Ok([0, 1].map(|i| {
            let (cells, flank) = (&self.flanks[i], Flank::new(&self.pair.gears[i], &wear, i));
            let mut rates = cells.normal_rates(&rubbings, i);
            // A flank with its normal at λ from Y moves along Y by 1/cos λ of what it loses along the normal.
            for (rate, alpha) in rates.iter_mut().zip(&cells.alphas_rad) {
                *rate /= flank.at(*alpha).lambda_sin_cos.1;
            }
            rates
        }))
    }

    /// Simulates wear up to the target in steps of at most `step_mm`.
    fn advance_to(&mut self, target: Target) -> Result<(), GearError> {
        for _ in 0..MAX_STEPS {
            let reached = match target {
                Target::Depth(depth) => self.deepest_mm() >= depth,
                Target::Turns(turns) => self.driving_turns >= turns,
            };
            if reached {
                return Ok(());
            }
            let rates = self.rates()?;
            let fastest = rates.iter().flatten().copied().fold(0.0, f64::max);
            let left = match target {
                Target::Depth(depth) => {
                    let cells =
                        self.flanks.iter().flat_map(|flank| &flank.depths_mm).zip(rates.iter().flatten());
                    let turns =
                        cells.filter(|(_, rate)| **rate > 0.0).map(|(worn, rate)| (depth - worn) / rate);
                    turns.fold(f64::INFINITY, f64::min)
                }
                Target::Turns(turns) => turns - self.driving_turns,
            };
            let turns = left.min(self.step_mm / fastest);
            for (flank, rates) in self.flanks.iter_mut().zip(&rates) {
                for (worn, rate) in flank.depths_mm.iter_mut().zip(rates) {
                    *worn += turns * rate;
                }
            }
            self.driving_turns += turns;
            if turns == left {
                self.snap_to(target);
            }
            self.wear().check_thickness(self.pair, self.deepest_mm())?;
        }
        let (field, value) = match target {
            Target::Depth(depth) => ("wear depth in mm", depth),
            Target::Turns(turns) => ("turns", turns),
        };
        Err(GearError::field(
            field,
            value,
            format!("at most the wear of {MAX_STEPS} steps of {} mm", self.step_mm),
        ))
    }

    /// Removes the rounding of the last step.
    fn snap_to(&mut self, target: Target) {
        match target {
            Target::Depth(depth) => {
                let scale = depth / self.deepest_mm();
                self.flanks.iter_mut().flat_map(|flank| &mut flank.depths_mm).for_each(|worn| *worn *= scale);
            }
            Target::Turns(turns) => self.driving_turns = turns,
        }
    }
}

#[cfg(test)]
mod tests;
