//! Fast check whether a described pair can be simulated from new to the usual greatest wear.

use super::mesh_cycle::MeshCycle;
use super::{
    ContactRule, ElasticBodies, FlankWear, GearError, GearPair, PairSpec, RunSettings, WearShape,
    simulate_together,
};

/// Number of positions of the mesh period in the check.
const POINTS: usize = 16;
/// Number of bisections of the depth at which rigid flanks lose contact.
const HALVINGS: usize = 8;

/// Number of depths checked, from none to the usual greatest.
const DEPTHS: usize = 8;
/// Length in seconds and sampling rate in hertz of the simulated vibration.
const SECONDS: f64 = 0.25;
const SAMPLE_RATE_HZ: f64 = 20_000.0;
/// Growth from the first to the last fifth of the simulation that counts as unbounded: a library's record is
/// eight times as long and would overflow.
const MAX_GROWTH: f64 = 10.0;

impl PairSpec {
    /// Like [`PairSpec::resolve`], and also computes the mesh of new flanks and of flanks worn down to
    /// [`PairSpec::usual_wear_um`], with the vibration under the threshold rule, where it can grow without
    /// bound. This takes some hundredths of a second.
    ///
    /// Wear by Archard's law is not simulated; the usual shape is used instead.
    ///
    /// # Errors
    /// Those of [`PairSpec::resolve`]; [`GearError::Field`] for the contact rule if flanks worn in the
    /// described shape lose contact, and for the damping if the vibration grows without bound; those of
    /// [`MeshCycle::compute`].
    pub fn check(&self) -> Result<GearPair, GearError> {
        let pair = self.resolve()?;
        match self.dynamics.contact {
            ContactRule::Loaded => {
                let bodies = ElasticBodies::new(&pair, &FlankWear::none())?;
                for depth_um in [0.0, self.usual_wear_um()] {
                    MeshCycle::coarse(&pair, Some(&bodies), &self.worn(&pair, depth_um)?, POINTS)?;
                }
            }
            ContactRule::Threshold => {
                let depth_um = |index: usize| self.usual_wear_um() * index as f64 / (DEPTHS - 1) as f64;
                let cycles: Vec<MeshCycle> = (0..DEPTHS)
                    .map(|index| self.rigid_cycle(&pair, depth_um(index)))
                    .collect::<Result<_, _>>()
                    .map_err(|error| self.contact_loss(&pair, error))?;
                self.check_growth(&pair, &cycles)?;
            }
        }
        Ok(pair)
    }

    /// Returns flanks worn in the described shape, or in the usual one instead of Archard's.
    fn worn(&self, pair: &GearPair, depth_um: f64) -> Result<FlankWear, GearError> {
        if self.wear.shape != WearShape::Archard {
            return FlankWear::from_shape(pair, depth_um * 1e-3);
        }
        let mut pair = pair.clone();
        pair.spec.wear.shape = WearShape::Parabolic;
        FlankWear::from_shape(&pair, depth_um * 1e-3)
    }

    fn rigid_cycle(&self, pair: &GearPair, depth_um: f64) -> Result<MeshCycle, GearError> {
        MeshCycle::coarse(pair, None, &self.worn(pair, depth_um)?, POINTS)
    }

    /// Describes the depth at which rigid flanks lose contact.
    fn contact_loss(&self, pair: &GearPair, error: GearError) -> GearError {
        if !matches!(error, GearError::NoContact { .. }) {
            return error;
        }
        let usual_um = self.usual_wear_um();
        let (mut carries_um, mut parts_um) = (0.0, usual_um);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (carries_um + parts_um);
            match self.rigid_cycle(pair, middle) {
                Ok(_) => carries_um = middle,
                Err(_) => parts_um = middle,
            }
        }
        let expected = format!(
            "loaded, or a less steep wear shape: worn by more than {carries_um:.3} of {usual_um:.3} µm in this shape, rigid flanks \
             lose contact during a part of the mesh period"
        );
        GearError::field("dynamics.contact", self.dynamics.contact, expected)
    }

    /// Rejects vibration that grows from mesh period to mesh period.
    fn check_growth(&self, pair: &GearPair, cycles: &[MeshCycle]) -> Result<(), GearError> {
        let run = RunSettings::nominal(pair, SAMPLE_RATE_HZ, SECONDS);
        let grows = |record: &Vec<f64>| {
            let peak = |part: &[f64]| part.iter().fold(0.0_f64, |most, sample| most.max(sample.abs()));
            let fifth = record.len() / 5;
            peak(&record[record.len() - fifth..]) > MAX_GROWTH * peak(&record[..fifth])
        };
        match simulate_together(pair, &cycles.iter().collect::<Vec<_>>(), &run, None) {
            Ok(records) if !records.iter().any(grows) => Ok(()),
            Ok(_) | Err(GearError::Unstable { .. }) => {
                let damping = self.dynamics.mesh_damping_ratio;
                let expected = format!(
                    "a larger value, more support damping, a speed other than {} Hz or the contact rule `loaded`: the varying mesh stiffness excites a \
                     vibration that grows without bound",
                    self.operation.shaft_speed_hz
                );
                Err(GearError::field("dynamics.mesh_damping_ratio", damping, expected))
            }
            Err(error) => Err(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::shen2022_spec;
    use crate::{ContactRule, GearError, PairSpec, WearShape};

    #[test]
    fn the_papers_pair_can_be_simulated_by_both_rules_and_in_every_shape() {
        for contact in [ContactRule::Threshold, ContactRule::Loaded] {
            for shape in [WearShape::Parabolic, WearShape::Floor, WearShape::Archard] {
                let mut spec = shen2022_spec();
                (spec.dynamics.contact, spec.wear.shape) = (contact, shape);
                assert!(spec.check().is_ok());
            }
        }
    }

    /// Light plastic gears on stiff supports that hardly damp: found among drawn pairs.
    #[test]
    fn vibration_that_grows_without_bound_is_rejected() {
        let mut spec = shen2022_spec();
        (spec.geometry.teeth, spec.geometry.module_mm, spec.geometry.face_width_mm) = ([36, 66], 1.33, 6.6);
        (spec.geometry.bore_radius_mm, spec.geometry.centre_distance_mm) = (Some([5.0, 9.0]), None);
        (spec.material.youngs_modulus_pa, spec.material.density_kg_per_m3) = (2.8e9, 1410.0);
        (spec.operation.torque_nm, spec.operation.output_torque_nm) = (0.025, None);
        (spec.supports.stiffness_n_per_m, spec.supports.damping_n_s_per_m) = (Some(2.8e8), Some(155.0));
        (spec.errors, spec.dynamics.mesh_damping_ratio) = (Default::default(), 0.001);
        let mut refused = 0;
        for speed in 70..100 {
            spec.operation.shaft_speed_hz = f64::from(speed);
            if let Err(GearError::Field { field, .. }) = spec.check() {
                assert_eq!(field, "dynamics.mesh_damping_ratio");
                refused += 1;
            }
        }
        assert!(refused > 0);
        spec.dynamics.mesh_damping_ratio = 0.3;
        assert!(spec.check().is_ok());
    }

    /// `fixtures/pairs/bad/worn-out-of-contact.toml`, whose library would fail after a part of its states.
    #[test]
    fn wear_that_separates_rigid_flanks_is_rejected_with_the_possible_depth() {
        let mut spec =
            PairSpec::from_toml(include_str!("../../../fixtures/pairs/bad/worn-out-of-contact.toml"))
                .unwrap();
        let refusal = spec.check().unwrap_err();
        let GearError::Field { field, value, expected } = &refusal else {
            panic!("{refusal}");
        };
        assert_eq!((*field, value.as_str()), ("dynamics.contact", "threshold"));
        assert!(expected.starts_with("loaded, or") && expected.contains("of 245.000 µm"), "{expected}");
        spec.dynamics.contact = ContactRule::Loaded;
        assert!(spec.check().is_ok());
    }
}
