//! The passage of pairs of teeth through the mesh, and how those within reach share the load.

use std::cell::OnceCell;

use super::load_sharing::{Candidate, ElasticBodies, MAX_PAIRS, Sharing};
use super::tooth_touch::{ToothPair, ToothTouch};
use super::{GearError, GearPair};

/// Mesh periods before the nominal start and after the nominal end of contact in which a pair may carry load.
const MARGIN_PERIODS: f64 = 0.45;

/// The contact of a single pair over its whole passage, at the cell boundaries, computed on demand.
pub(super) struct Passage<'a> {
    teeth: &'a ToothPair<'a>,
    start_rad: f64,
    pitch_rad: f64,
    /// Number of cells per mesh period.
    cells: usize,
    /// Cell of the first contact, counted from the nominal start.
    first: i64,
    touches: Vec<OnceCell<Option<ToothTouch>>>,
}

/// One position of the mesh period.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    pub(super) stiffness_n_per_m: f64,
    pub(super) phi2_rad: f64,
    pub(super) uste_rad: f64,
    pub(super) carrying: u32,
    pub(super) leader: i32,
}

/// Pairs of teeth that may carry load, and their load sharing.
pub(super) struct Shared {
    leader: Candidate,
    /// Leading pair first.
    pub(super) candidates: Vec<Candidate>,
    pub(super) sharing: Sharing,
}

impl<'a> Passage<'a> {
    pub(super) fn new(pair: &GearPair, teeth: &'a ToothPair<'a>, cells: usize) -> Self {
        let margin = (MARGIN_PERIODS * cells as f64).ceil() as i64;
        let last = (pair.contact_ratio() * cells as f64).ceil() as i64 + margin;
        Self {
            teeth,
            start_rad: pair.start_of_contact_rad(),
            pitch_rad: pair.gears[0].pitch_angle_rad(),
            cells,
            first: -margin,
            touches: (-margin..=last).map(|_| OnceCell::new()).collect(),
        }
    }

    pub(super) fn phi1_rad(&self, cell: i64) -> f64 {
        self.start_rad + self.pitch_rad * (cell as f64 / self.cells as f64)
    }

    fn touch(&self, index: usize) -> Option<ToothTouch> {
        let touch = self.touches.get(index)?;
        *touch.get_or_init(|| self.teeth.touch(self.phi1_rad(index as i64 + self.first)))
    }

    pub(super) fn place(
        &self,
        pair: &GearPair,
        bodies: &ElasticBodies,
        cell: usize,
    ) -> Result<Place, GearError> {
        let [driving, driven] = &pair.gears;
        let base_m = driving.base_radius_mm * 1e-3;
        let Shared { leader, sharing, .. } = self.shared(pair, bodies, cell)?;
        let phi2_rad = leader.touch.phi2_rad - f64::from(leader.tooth) * driven.pitch_angle_rad();
        Ok(Place {
            stiffness_n_per_m: pair.spec.operation.torque_nm / (base_m * base_m * sharing.rotation_rad),
            phi2_rad,
            uste_rad: driving.base_radius_mm / driven.base_radius_mm * self.phi1_rad(cell as i64)
                - phi2_rad
                - pair.perfect_lag_rad(),
            carrying: sharing.carrying,
            leader: leader.tooth,
        })
    }

    /// Returns the pairs within reach at a cell of the period, the leading one first; `pitch_rad` is the
    /// driven gear's.
    fn candidates(&self, cell: usize, pitch_rad: f64) -> Vec<Candidate> {
        let (cells, last) = (self.cells as i64, self.first + self.touches.len() as i64 - 1);
        let (least, most) =
            ((self.first - cell as i64).div_euclid(cells), (last - cell as i64).div_euclid(cells));
        let mut candidates: Vec<Candidate> = (least..=most)
            .filter_map(|tooth| {
                let index = usize::try_from(cell as i64 + tooth * cells - self.first).ok()?;
                let touch = self.touch(index)?;
                Some(Candidate {
                    tooth: tooth as i32,
                    touch,
                    behind_rad: tooth as f64 * pitch_rad - touch.phi2_rad,
                })
            })
            .collect();
        candidates.sort_by(|a, b| a.behind_rad.total_cmp(&b.behind_rad));
        if let Some(lead) = candidates.first().map(|leader| leader.behind_rad) {
            candidates.iter_mut().for_each(|candidate| candidate.behind_rad -= lead);
        }
        candidates
    }

    /// Computes how the pairs within reach at a cell of the period share the pair's torque.
    pub(super) fn shared(
        &self,
        pair: &GearPair,
        bodies: &ElasticBodies,
        cell: usize,
    ) -> Result<Shared, GearError> {
        let [driving, driven] = &pair.gears;
        let torque_nm = pair.spec.operation.torque_nm;
        // N·mm per mm of width.
        let torque_n = torque_nm * 1e3 / pair.spec.geometry.face_width_mm;
        let phi1_rad =
            pair.start_of_contact_rad() + driving.pitch_angle_rad() * (cell as f64 / self.cells as f64);
        let mut candidates = self.candidates(cell, driven.pitch_angle_rad());
        let leader = *candidates.first().ok_or(GearError::NoContact { phi1_rad })?;
        let most = bodies.alone_rad(&leader.touch, torque_n);
        candidates.retain(|other| other.behind_rad * other.touch.arms_mm[1] <= most * other.touch.arms_mm[0]);
        let further = candidates.split_off(candidates.len().min(MAX_PAIRS));
        // Under an excessive force the contact's own compliance, a logarithm of its width, is no longer
        // valid.
        let overloaded = GearError::Overloaded { torque_nm, phi1_rad };
        if candidates.is_empty() {
            return Err(overloaded);
        }
        let sharing = bodies.share(&candidates, torque_n);
        if !(sharing.rotation_rad > 0.0 && sharing.rotation_rad.is_finite()) {
            return Err(overloaded);
        }
        let touches = |other: &Candidate| {
            other.behind_rad * other.touch.arms_mm[1] < sharing.rotation_rad * other.touch.arms_mm[0]
        };
        if further.iter().any(touches) {
            let expected = format!(
                "threshold, or shorter teeth: at phi1 = {phi1_rad:.5} rad more than {MAX_PAIRS} pairs of teeth touch under {torque_nm} N·m, \
                 whose sharing of the load is not modelled"
            );
            return Err(GearError::field("dynamics.contact", pair.spec.dynamics.contact, expected));
        }
        Ok(Shared { leader, candidates, sharing })
    }
}
