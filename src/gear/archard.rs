//! Wear of both flanks after Archard, Eq. (22), stepped as the flanks change.
//!
//! In the turn dφ₁ a contact under the force F per width slides by |u₁ − u₂| dφ₁ and takes K/H · F |u₁ − u₂| dφ₁ off each flank, spread over its Hertz band of
//! half-width a as the pressure is. On involutes the band sweeps the flank at u_i, so that a point loses k · p̄ · 2a |1 − u_j/u_i| each mesh:
//! the single-point observation of Flodin and Andersson (Wear 207, 1997). Taking the volume off where the contact stands also holds where wear makes it
//! linger or stand on a tip's edge.
//!
//! Forces and contacts are worked out anew at every step of wear (Ding and Kahraman, J. Sound Vib. 307, 2007), with the contact rule of the pair. The spreading
//! over the Hertz band is the only smoothing.

use std::f64::consts::PI;

use super::contact_load::{ContactLoad, arc_mm, contact_loads};
use super::error::within;
use super::wear::WearProfile;
use super::wear_table::DepthCurve;
use super::{ContactRule, ElasticBodies, Flank, FlankWear, GearError, GearPair};

/// Cells of each flank's active profile, even in arc length.
const CELLS: usize = 64;
/// Greatest change of any depth in mm before forces and contacts are worked out anew: below the backlash that the threshold rule lets pass
/// (1e-4 rad, 7 µm on the base circle), so that the lead goes to and fro between pairs in small steps.
const STEP_MM: f64 = 2e-3;
/// Most steps of one course of wear.
const MOST_STEPS: usize = 20_000;

/// Flanks worn after Archard and how long it took.
#[derive(Debug, Clone, PartialEq)]
pub struct ArchardWear {
    /// Both flanks.
    pub wear: FlankWear,
    /// Turns of the driving gear: load cycles of each of its teeth. Those of the driven gear are z₁/z₂ times as many.
    pub driving_turns: f64,
}

impl ArchardWear {
    /// The states of one course of wear at which the greatest depth of both flanks, along Y, is each of `depths_mm`, which rise.
    ///
    /// # Errors
    /// [`GearError::Field`] for depths that do not rise from 0, or leave less than half of the tooth; [`GearError::NoContact`] where the worn
    /// flanks no longer carry the mesh over the whole period.
    pub fn at_depths(pair: &GearPair, depths_mm: &[f64]) -> Result<Vec<Self>, GearError> {
        let mut course = Course::new(pair, STEP_MM)?;
        let mut least = 0.0;
        let mut states = Vec::with_capacity(depths_mm.len());
        for depth_mm in depths_mm {
            within("wear depth in mm", *depth_mm, least, f64::MAX)?;
            least = *depth_mm;
            course.until(Goal::Depth(*depth_mm))?;
            states.push(course.state());
        }
        Ok(states)
    }

    /// The flanks after a number of turns of the driving gear.
    ///
    /// # Errors
    /// As [`ArchardWear::at_depths`]; [`GearError::Field`] for turns below 0 or so many that the teeth are worn through.
    pub fn after_turns(pair: &GearPair, driving_turns: f64) -> Result<Self, GearError> {
        within("turns", driving_turns, 0.0, f64::MAX)?;
        let mut course = Course::new(pair, STEP_MM)?;
        course.until(Goal::Turns(driving_turns))?;
        Ok(course.state())
    }
}

/// What a part of the course ends at.
#[derive(Debug, Clone, Copy)]
enum Goal {
    Depth(f64),
    Turns(f64),
}

/// The active profile of one gear in cells.
#[derive(Debug, Clone)]
struct FlankCells {
    /// Arc length and α₁ at the cells' middles: the ends of the first and last cell lie half a cell beyond start of active profile and tip.
    arcs_mm: Vec<f64>,
    alphas_rad: Vec<f64>,
    radii_mm: Vec<f64>,
    /// Depth along Y.
    depths_mm: Vec<f64>,
    cell_mm: f64,
    /// k = K/H in mm²/N times meshes of a tooth in a turn of the driving gear.
    wear_mm2_per_n: f64,
}

/// Wear as it goes on.
struct Course<'a> {
    pair: &'a GearPair,
    bodies: Option<ElasticBodies>,
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
        let roll = |arc: &f64| (2.0 * arc / gear.base_radius_mm).sqrt();
        let spec = &pair.spec.wear;
        let meshes = f64::from(pair.gears[0].teeth) / f64::from(gear.teeth);
        Self {
            alphas_rad: arcs_mm.iter().map(|arc| roll(arc) - gear.base_half_angle_rad).collect(),
            radii_mm: arcs_mm.iter().map(|arc| gear.base_radius_mm * 1.0_f64.hypot(roll(arc))).collect(),
            depths_mm: vec![0.0; arcs_mm.len()],
            arcs_mm,
            cell_mm,
            wear_mm2_per_n: spec.coefficient / spec.hardness_pa[i] * 1e6 * meshes,
        }
    }

    /// Growth of the depth along the flank's normal in mm per turn of the driving gear.
    fn normal_rates(&self, loads: &[ContactLoad], i: usize) -> Vec<f64> {
        let mut rates = vec![0.0; self.arcs_mm.len()];
        for load in loads {
            let slide = (load.rolling_mm_per_rad[0] - load.rolling_mm_per_rad[1]).abs() * load.turn_rad;
            let area = self.wear_mm2_per_n * load.force_n_per_mm * slide;
            self.spread(&mut rates, area, load.arc_mm[i], load.half_width_mm);
        }
        rates
    }

    /// Takes `area` in mm² off the cells under a Hertz band around `middle`; what would lie beyond the flank's ends is taken off the rest.
    fn spread(&self, rates: &mut [f64], area: f64, middle: f64, half_width: f64) {
        let last = self.arcs_mm.len() - 1;
        let (start, end) = (self.arcs_mm[0], self.arcs_mm[last]);
        let middle = middle.clamp(start, end);
        let half_width = half_width.max(0.5 * self.cell_mm);
        let below = |arc: f64| below_pressure((arc.clamp(start, end) - middle) / half_width);
        let whole = below(end) - below(start);
        let place = |arc: f64| ((arc - start) / self.cell_mm).round().clamp(0.0, last as f64) as usize;
        let (first, after) = (place(middle - half_width), place(middle + half_width) + 1);
        for (cell, rate) in rates.iter_mut().enumerate().take(after).skip(first) {
            let part = below(self.arcs_mm[cell] + 0.5 * self.cell_mm) - below(self.arcs_mm[cell] - 0.5 * self.cell_mm);
            // The end cells are cut in half by the flank's ends.
            let width = if cell == 0 || cell == last { 0.5 } else { 1.0 } * self.cell_mm;
            *rate += area * part / (whole * width);
        }
    }

    fn deepest_mm(&self) -> f64 {
        self.depths_mm.iter().copied().fold(0.0, f64::max)
    }
}

/// Part of a Hertz pressure's force below the place `t` in half-widths from its middle.
fn below_pressure(t: f64) -> f64 {
    let t = t.clamp(-1.0, 1.0);
    0.5 + (t * (1.0 - t * t).sqrt() + t.asin()) / PI
}

impl<'a> Course<'a> {
    fn new(pair: &'a GearPair, step_mm: f64) -> Result<Self, GearError> {
        // What the teeth give way changes little with their wear: the bodies stay those of the unworn gears.
        let bodies = match pair.spec.dynamics.contact {
            ContactRule::Loaded => Some(ElasticBodies::new(pair, &FlankWear::none())?),
            ContactRule::Threshold => None,
        };
        Ok(Self {
            pair,
            bodies,
            flanks: [0, 1].map(|i| FlankCells::new(pair, i)),
            driving_turns: 0.0,
            step_mm,
        })
    }

    fn wear(&self) -> FlankWear {
        let profile = |flank: &FlankCells| {
            let points: Vec<(f64, f64)> = flank.radii_mm.iter().copied().zip(flank.depths_mm.iter().copied()).collect();
            WearProfile::Table(DepthCurve::new(&points))
        };
        if self.deepest_mm() > 0.0 {
            FlankWear {
                profiles: self.flanks.each_ref().map(profile),
            }
        } else {
            FlankWear::none()
        }
    }

    fn state(&self) -> ArchardWear {
        ArchardWear {
            wear: self.wear(),
            driving_turns: self.driving_turns,
        }
    }

    fn deepest_mm(&self) -> f64 {
        self.flanks.iter().map(FlankCells::deepest_mm).fold(0.0, f64::max)
    }

    /// Growth of the depths along Y in mm per turn of the driving gear.
    fn rates(&self) -> Result<[Vec<f64>; 2], GearError> {
        let wear = self.wear();
        let loads = contact_loads(self.pair, &wear, self.bodies.as_ref())?;
        Ok([0, 1].map(|i| {
            let (cells, flank) = (&self.flanks[i], Flank::new(&self.pair.gears[i], &wear, i));
            let mut rates = cells.normal_rates(&loads, i);
            // A flank with its normal at λ from Y moves along Y by 1/cos λ of what it loses along the normal.
            for (rate, alpha) in rates.iter_mut().zip(&cells.alphas_rad) {
                *rate /= flank.at(*alpha).lambda_sin_cos.1;
            }
            rates
        }))
    }

    /// Wears on to the goal in steps of at most `step_mm`.
    fn until(&mut self, goal: Goal) -> Result<(), GearError> {
        for _ in 0..MOST_STEPS {
            let reached = match goal {
                Goal::Depth(depth) => self.deepest_mm() >= depth,
                Goal::Turns(turns) => self.driving_turns >= turns,
            };
            if reached {
                return Ok(());
            }
            let rates = self.rates()?;
            let fastest = rates.iter().flatten().copied().fold(0.0, f64::max);
            let left = match goal {
                Goal::Depth(depth) => {
                    let cells = self.flanks.iter().flat_map(|flank| &flank.depths_mm).zip(rates.iter().flatten());
                    let turns = cells.filter(|(_, rate)| **rate > 0.0).map(|(worn, rate)| (depth - worn) / rate);
                    turns.fold(f64::INFINITY, f64::min)
                }
                Goal::Turns(turns) => turns - self.driving_turns,
            };
            let turns = left.min(self.step_mm / fastest);
            for (flank, rates) in self.flanks.iter_mut().zip(&rates) {
                for (worn, rate) in flank.depths_mm.iter_mut().zip(rates) {
                    *worn += turns * rate;
                }
            }
            self.driving_turns += turns;
            if turns == left {
                self.settle(goal);
            }
            self.wear().check_thickness(self.pair, self.deepest_mm())?;
        }
        let (field, value) = match goal {
            Goal::Depth(depth) => ("wear depth in mm", depth),
            Goal::Turns(turns) => ("turns", turns),
        };
        Err(GearError::field(
            field,
            value,
            format!("what {MOST_STEPS} steps of {STEP_MM} mm of wear reach"),
        ))
    }

    /// Takes the rounding of the last step off.
    fn settle(&mut self, goal: Goal) {
        match goal {
            Goal::Depth(depth) => {
                let scale = depth / self.deepest_mm();
                self.flanks
                    .iter_mut()
                    .flat_map(|flank| &mut flank.depths_mm)
                    .for_each(|worn| *worn *= scale);
            }
            Goal::Turns(turns) => self.driving_turns = turns,
        }
    }
}

#[cfg(test)]
mod tests;
