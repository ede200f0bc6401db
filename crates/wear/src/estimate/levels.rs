//! Recent levels of a channel's values, and whether all of them have changed at once by one factor, which
//! proves a change of gain.
//!
//! A change of gain multiplies mesh lines, shaft lines and noise alike from one record to the next, is
//! lasting, and leaves the kurtosis as it was. A change that grows over many records, differs between bands,
//! or makes the signal more impulsive comes from the machine.

use flankwatch_signal::{ByName, Name};
use serde::{Deserialize, Serialize};

use super::deviation::{Deviation, chi_square_score};
use super::novelty::octave_hz;

/// Weight of the newest record in a level, and the resulting variance of a level over that of a record.
const NEWEST_PART: f64 = 0.15;
const LEVEL_VARIANCE: f64 = NEWEST_PART / (2.0 - NEWEST_PART);

/// A change of gain moves all values by at least this logarithm ...
const MIN_GAIN: f64 = 0.15;

/// ... leaves at most this part of the sum of squares ...
const MAX_RESIDUAL_PART: f64 = 0.3;

/// ... and a remainder that chance explains: at most this many standard deviations, with the sum of squares
/// of correlated values inflated by this factor.
const MAX_RESIDUAL_SCORE: f64 = 3.0;
const INFLATION: f64 = 2.0;

/// Largest change of the gain's logarithm, once proven, for it to count as the same.
const GAIN_TOLERANCE: f64 = 0.2;

/// Unexplained records within which a change of gain has to be proven: later, something else came first.
const RECORDS_TO_PROVE: u8 = 3;

/// Least standard deviation of a value between records.
const MIN_SCATTER: f64 = 0.03;

/// Lines have fallen with the noise floor where none rose above it by more than this logarithm: wear and the
/// slope of a loss within the octave change a line by less.
const FALL_TOLERANCE: f64 = 1.8;

/// Fewest values from which a change of gain is recognised.
const MIN_VALUES: usize = 6;

/// The kurtosis exceeds the healthy ones beyond this many of their standard deviations and this logarithm.
const IMPULSIVE_DEVIATIONS: f64 = 3.0;
const IMPULSIVE_LOGARITHM: f64 = 0.12;

/// Levels of a channel's values. A copy through JSON continues with bit-identical results.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Levels {
    /// By value: level (measured minus healthy) over the explained records, and variance around it.
    levels: ByName<[f32; 2]>,
    #[serde(rename = "since")]
    last_outcome: Outcome,
}

/// Outcome of the records since the last one that wear explained.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Outcome {
    /// The last record was explained.
    #[default]
    Explained,
    /// All values changed by this logarithm.
    Gain(f32),
    /// This many records were unexplained, and not by a change of gain.
    #[serde(rename = "else")]
    Other(u8),
}

/// Whether a record's kurtosis exceeds the healthy ones.
pub(super) fn is_impulsive(kurtosis: &Deviation) -> bool {
    kurtosis.residual > IMPULSIVE_LOGARITHM.max(IMPULSIVE_DEVIATIONS * kurtosis.deviation)
}

impl Levels {
    /// Returns the logarithm of the factor by which all `values` changed at once after the last explained
    /// record, where they did. `values` and `kurtosis` are deviations from the healthy ones.
    pub(super) fn gain(
        &self,
        values: &[Deviation],
        kurtosis: Option<&Deviation>,
        freedom: f64,
    ) -> Option<f64> {
        if values.len() < MIN_VALUES {
            return None;
        }
        let moved: Vec<Deviation> = values.iter().map(|value| self.deviation_from_level(value)).collect();
        let weight = |d: &Deviation| d.deviation.powi(-2);
        let gain =
            moved.iter().map(|d| weight(d) * d.residual).sum::<f64>() / moved.iter().map(weight).sum::<f64>();
        let squares = |by: f64| -> f64 {
            let left = |d: &Deviation| Deviation { residual: d.residual - by, ..d.clone() };
            moved.iter().map(|d| left(d).normal_score(freedom).powi(2)).sum()
        };
        let left = squares(gain);
        let alike = left < MAX_RESIDUAL_PART * squares(0.0);
        let by_chance = chi_square_score(left / INFLATION, moved.len() - 1) < MAX_RESIDUAL_SCORE;
        let shape_stays =
            |d: &Deviation| d.residual.abs() <= IMPULSIVE_LOGARITHM.max(IMPULSIVE_DEVIATIONS * d.deviation);
        let proven = match self.last_outcome {
            Outcome::Gain(before) => (gain - f64::from(before)).abs() < GAIN_TOLERANCE,
            Outcome::Other(records) if records >= RECORDS_TO_PROVE => false,
            Outcome::Explained | Outcome::Other(_) => {
                by_chance && kurtosis.is_none_or(|kurtosis| shape_stays(&self.deviation_from_level(kurtosis)))
            }
        };
        (gain.abs() > MIN_GAIN && alike && proven).then_some(gain)
    }

    /// Whether the lines of the highest octave with a noise floor have fallen as far as that floor; `None`
    /// where no line lies there. `frequencies_hz` are the lines' frequencies by name.
    pub(super) fn lines_fell(&self, values: &[Deviation], frequencies_hz: &[(Name, f64)]) -> Option<bool> {
        let floors = values.iter().filter(|value| value.name.starts_with("ln_floor_"));
        let octaves = floors
            .filter_map(|floor| Some((octave_hz(&floor.name)?, self.deviation_from_level(floor).residual)));
        let ([low, high], floor) = octaves.max_by(|a, b| a.0[0].total_cmp(&b.0[0]))?;
        let inside = frequencies_hz.iter().filter(|(_, hz)| (low..high).contains(hz));
        let lines = inside.filter_map(|(name, _)| values.iter().find(|value| value.name == *name));
        let highest =
            lines.map(|line| self.deviation_from_level(line).residual - floor).max_by(f64::total_cmp);
        highest.map(|beside| beside < FALL_TOLERANCE)
    }

    /// Adds a record that wear explains.
    pub(super) fn add_explained<'a>(&mut self, values: impl Iterator<Item = &'a Deviation>) {
        self.last_outcome = Outcome::Explained;
        for value in values {
            let [mut level, mut variance] = self.levels.get(&value.name).copied().unwrap_or([0.0; 2]);
            let beside = value.residual - f64::from(level);
            level += (NEWEST_PART * beside) as f32;
            variance += (NEWEST_PART * (beside * beside - f64::from(variance))) as f32;
            self.levels.insert(value.name.clone(), [level, variance]);
        }
    }

    /// Adds a record that wear does not explain, with the change of gain that does.
    pub(super) fn add_unexplained(&mut self, gain: Option<f64>) {
        self.last_outcome = match (gain, self.last_outcome) {
            (Some(gain), _) => Outcome::Gain(gain as f32),
            (None, Outcome::Gain(before)) => Outcome::Gain(before),
            (None, Outcome::Other(records)) => Outcome::Other(records.saturating_add(1)),
            (None, Outcome::Explained) => Outcome::Other(1),
        };
    }

    fn deviation_from_level(&self, value: &Deviation) -> Deviation {
        let [level, lately] = self.levels.get(&value.name).map_or([0.0; 2], |level| level.map(f64::from));
        // A line may scatter more with wear than in the baseline.
        let variance = (1.0 + LEVEL_VARIANCE) * (value.deviation * value.deviation).max(lately)
            + MIN_SCATTER * MIN_SCATTER;
        Deviation { name: value.name.clone(), residual: value.residual - level, deviation: variance.sqrt() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(residuals: [f64; 8]) -> Vec<Deviation> {
        let value = |(i, residual): (usize, f64)| deviation(&i.to_string(), residual);
        residuals.into_iter().enumerate().map(value).collect()
    }

    fn deviation(name: &str, residual: f64) -> Deviation {
        Deviation { name: name.into(), residual, deviation: 0.05 }
    }

    #[test]
    fn one_factor_at_once_is_a_lasting_change_of_gain() {
        let mut levels = Levels::default();
        levels.add_explained(values([0.02; 8]).iter());
        for _ in 0..5 {
            let gain = levels.gain(&values([0.69, 0.71, 0.66, 0.7, 0.72, 0.69, 0.68, 0.7]), None, 20.0);
            assert!(gain.is_some_and(|gain| (gain - 0.69).abs() < 0.03), "{gain:?}");
            levels.add_unexplained(gain);
        }
        assert_eq!(levels.gain(&values([1.4; 8]), None, 20.0), None, "the factor changed again");
    }

    #[test]
    fn a_change_of_kurtosis_is_no_gain() {
        let levels = Levels::default();
        assert!(levels.gain(&values([0.7; 8]), Some(&deviation("ln_kurtosis", 0.05)), 20.0).is_some());
        assert_eq!(levels.gain(&values([0.7; 8]), Some(&deviation("ln_kurtosis", 0.5)), 20.0), None);
    }

    #[test]
    fn a_change_that_differs_between_values_is_no_gain() {
        let levels = Levels::default();
        assert_eq!(levels.gain(&values([0.7, 0.7, 0.7, 0.2, 0.7, 1.1, 0.7, 0.7]), None, 20.0), None);
    }

    /// 2 % a record: by the time the fit fails, the level has followed.
    #[test]
    fn slow_growth_is_no_gain() {
        let mut levels = Levels::default();
        for record in 1..40 {
            levels.add_explained(values([0.02 * f64::from(record); 8]).iter());
        }
        assert_eq!(levels.gain(&values([0.8; 8]), None, 20.0), None);
    }

    #[test]
    fn lines_that_fall_with_the_noise_are_recognised() {
        let levels = Levels::default();
        let values =
            [("ln_floor_500hz", 0.0), ("ln_floor_4000hz", -1.6), ("ln_mesh_4", 0.4), ("ln_mesh_5", -1.9)];
        let values = values.map(|(name, residual)| deviation(name, residual));
        let at = |name: &str, hz: f64| (name.into(), hz);
        assert_eq!(levels.lines_fell(&values, &[at("ln_mesh_5", 4700.0)]), Some(true));
        assert_eq!(
            levels.lines_fell(&values, &[at("ln_mesh_4", 3800.0), at("ln_mesh_5", 4700.0)]),
            Some(false)
        );
        assert_eq!(levels.lines_fell(&values, &[at("ln_mesh_4", 900.0)]), None);
    }

    #[test]
    fn a_gain_after_other_unexplained_records_is_not_proven() {
        let mut levels = Levels::default();
        for _ in 0..3 {
            levels.add_unexplained(None);
        }
        assert_eq!(levels.gain(&values([0.7; 8]), None, 20.0), None);
        levels.add_explained(values([0.0; 8]).iter());
        assert!(levels.gain(&values([0.7; 8]), None, 20.0).is_some());
    }
}
