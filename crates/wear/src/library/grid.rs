//! The grid: wear states × torques × speeds.

use serde::{Deserialize, Serialize};

use super::LibraryError;
use flankwatch_gear::PairSpec;
use flankwatch_signal::MAX_RECORD_SAMPLES;

/// Most torques and most speeds.
const MAX_FACTORS: usize = 32;
/// Least and greatest factor on the pair's torque or speed.
const FACTORS: (f64, f64) = (0.01, 100.0);

/// The grid of wear states and operating points, and how each point of it is simulated.
///
/// Torques and speeds are rising factors on the pair's own and include 1, the nominal operating point. Every
/// wear state is simulated at every combination of both.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GridSettings {
    /// Number of wear states, equally spaced from unworn to `max_wear_um`.
    pub states: usize,
    /// Greatest wear depth of the last state in µm; [`GridSettings::for_pair`] scales it to a pair's size.
    pub max_wear_um: f64,
    /// Length of each simulated record in seconds.
    pub seconds: f64,
    /// Sampling rate of each simulated record in hertz.
    pub sample_rate_hz: f64,
    /// Seed of the random error, the same at every point of the grid.
    pub seed: u64,
    /// Torques as factors on the pair's `torque_nm`; the torques of both gears keep their ratio.
    pub torque_factors: Vec<f64>,
    /// Speeds as factors on the pair's `shaft_speed_hz`.
    pub speed_factors: Vec<f64>,
}

impl Default for GridSettings {
    /// The paper's grid: 50 states of 5 µm from 0 to 0.245 mm, for module 6 mm, at the nominal operating
    /// point.
    fn default() -> Self {
        Self {
            states: 50,
            max_wear_um: 245.0,
            seconds: 2.0,
            sample_rate_hz: 20_000.0,
            seed: 1,
            torque_factors: vec![1.0],
            speed_factors: vec![1.0],
        }
    }
}

impl GridSettings {
    /// Returns the grid for a pair, with the depths, which apply to module 6 mm, scaled to its module.
    #[must_use]
    pub fn for_pair(&self, pair: &PairSpec) -> Self {
        Self { max_wear_um: self.max_wear_um * pair.size(), ..self.clone() }
    }

    /// Returns the greatest wear depth of a state in µm.
    pub fn wear_um(&self, index: usize) -> f64 {
        self.max_wear_um * index as f64 / (self.states - 1) as f64
    }

    /// Number of combinations of torque and speed.
    pub fn operating_points(&self) -> usize {
        self.torque_factors.len() * self.speed_factors.len()
    }

    /// Number of records that are simulated.
    pub fn simulations(&self) -> usize {
        self.states * self.operating_points()
    }

    /// Checks that the grid can be simulated.
    ///
    /// # Errors
    /// [`LibraryError::Grid`] with the field, its value and the expected value.
    pub fn validate(&self) -> Result<(), LibraryError> {
        let refuse = |field, value: String, expected| Err(LibraryError::Grid { field, value, expected });
        if !(2..=10_000).contains(&self.states) {
            return refuse("states", self.states.to_string(), "a number from 2 to 10000");
        }
        if !(self.max_wear_um > 0.0 && self.max_wear_um.is_finite()) {
            return refuse("max_wear_um", self.max_wear_um.to_string(), "a finite depth above 0");
        }
        if !(0.1..=600.0).contains(&self.seconds) {
            return refuse("seconds", self.seconds.to_string(), "a length from 0.1 to 600 s");
        }
        if !(1000.0..=1e6).contains(&self.sample_rate_hz) {
            return refuse(
                "sample_rate_hz",
                self.sample_rate_hz.to_string(),
                "a rate from 1000 to 1000000 Hz",
            );
        }
        let samples = self.seconds * self.sample_rate_hz;
        if samples > MAX_RECORD_SAMPLES as f64 {
            return refuse(
                "seconds × sample_rate_hz",
                samples.to_string(),
                "at most 16777216 samples a record",
            );
        }
        for (field, factors) in [("torques", &self.torque_factors), ("speeds", &self.speed_factors)] {
            let sound = factors.iter().all(|factor| (FACTORS.0..=FACTORS.1).contains(factor))
                && factors.windows(2).all(|two| two[0] < two[1])
                && factors.contains(&1.0)
                && factors.len() <= MAX_FACTORS;
            if !sound {
                return refuse(
                    field,
                    format!("{factors:?}"),
                    "at most 32 rising factors from 0.01 to 100 that include 1, the pair's own",
                );
            }
        }
        Ok(())
    }
}

/// Returns the cell of a value on an axis of the grid and the fraction within it, limited to the ends.
/// `factors` are rising and not empty.
pub(super) fn place(factors: &[f64], factor: f64) -> (usize, f64) {
    let after = factors.partition_point(|at| *at <= factor);
    if after == 0 {
        return (0, 0.0);
    }
    if after == factors.len() {
        return (after - 1, 0.0);
    }
    let (low, high) = (factors[after - 1], factors[after]);
    (after - 1, (factor - low) / (high - low))
}

#[cfg(test)]
mod tests {
    use super::super::testing::synthetic_library;
    use super::{GridSettings, place};

    #[test]
    fn depths_scale_with_the_module() {
        let mut pair = synthetic_library().pair().clone();
        let usual = GridSettings::default();
        assert_eq!(usual.for_pair(&pair), usual);
        pair.geometry.module_mm = 0.3;
        assert!((usual.for_pair(&pair).max_wear_um - 12.25).abs() < 1e-12);
        assert_eq!(usual.for_pair(&pair).states, 50);
    }

    #[test]
    fn records_longer_than_a_record_may_be_are_rejected() {
        let grid = |seconds| GridSettings { seconds, sample_rate_hz: 1e6, ..GridSettings::default() };
        let error = grid(600.0).validate().unwrap_err().to_string();
        assert!(
            error.contains("seconds × sample_rate_hz is 600000000, expected at most 16777216"),
            "{error}"
        );
        assert!(grid(16.7).validate().is_ok());
    }

    #[test]
    fn places_are_limited_to_the_ends() {
        let factors = [0.5, 1.0, 1.5];
        for (factor, wanted) in [
            (0.1, (0, 0.0)),
            (0.5, (0, 0.0)),
            (0.75, (0, 0.5)),
            (1.0, (1, 0.0)),
            (1.375, (1, 0.75)),
            (1.5, (2, 0.0)),
            (9.0, (2, 0.0)),
        ] {
            assert_eq!(place(&factors, factor), wanted);
        }
        assert_eq!(place(&[1.0], 0.3), (0, 0.0));
    }

    #[test]
    fn invalid_factors_are_rejected_with_their_axis() {
        let invalid =
            [vec![], vec![0.5, 2.0], vec![1.0, 1.0], vec![1.0, 0.5], vec![-1.0, 1.0], vec![1.0, f64::NAN]];
        for factors in invalid {
            let torques = GridSettings { torque_factors: factors.clone(), ..GridSettings::default() };
            let speeds = GridSettings { speed_factors: factors, ..GridSettings::default() };
            assert!(torques.validate().unwrap_err().to_string().starts_with("library torques is ["));
            assert!(speeds.validate().unwrap_err().to_string().starts_with("library speeds is ["));
        }
        let many =
            GridSettings { speed_factors: (1..=33).map(f64::from).collect(), ..GridSettings::default() };
        assert!(many.validate().is_err());
        assert!(GridSettings::default().validate().is_ok());
    }
}
