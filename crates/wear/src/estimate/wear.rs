//! The wear estimate: a depth with an interval, or the reason why there is none.

use serde::{Deserialize, Serialize};

use super::novelty::Novelty;
use super::prognosis::Prognosis;
use flankwatch_signal::{Features, Indicators, PREPROCESSING};

/// Identifier of the estimator.
pub const METHOD: &str = "ensemble-filter-10";

/// Status of a wear estimate.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum WearStatus {
    /// Records are still being collected for the asset's healthy baseline.
    #[default]
    CollectingBaseline,
    /// The asset has no gear pair described, so there is no library to compare with.
    NoLibrary,
    /// The machine has no gear mesh, so there is no wear to estimate; records are judged by novelty alone.
    NoMesh,
    /// The library to compare with is still being simulated; the estimate follows.
    AwaitingLibrary,
    /// A first estimate from a part of the library: the final one follows when all of it is simulated.
    Provisional,
    /// The library to compare with could not be simulated.
    LibraryFailed,
    /// The record has no features to compare (no shaft speed was found, for example).
    NoFeatures,
    /// The shaft speed found in the record, or the described number of teeth, is in doubt.
    SpeedInDoubt,
    /// The record is too short or too sparsely sampled to be compared with the baseline.
    NotComparable,
    /// The records do not determine the depth: the interval spans most of the library, they contradict each
    /// other, or the baseline is too poor for a depth.
    NotIdentifiable,
    /// No state of the library explains the record: something other than wear has changed.
    OutsideLibrary,
    /// The sensor, not the machine, is the reason why the library does not explain the record.
    SensorFault,
    /// A wear depth with an interval.
    Estimated,
    /// Earlier records are being recomputed; the estimate follows.
    Recomputing,
    /// The record was excluded from the estimate.
    Excluded,
}

/// Why there is no library to compare with.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum MissingLibrary {
    /// No gear pair is described.
    #[default]
    NotDescribed,
    /// The machine has no gear mesh.
    NoMesh,
    /// The library is still being simulated.
    Simulating,
    /// The library could not be simulated, for this reason.
    Failed(String),
}

impl MissingLibrary {
    /// Returns the status and reason for records meanwhile; `None` where they do not need a library.
    fn status_and_reason(&self) -> Option<(WearStatus, String)> {
        match self {
            Self::NotDescribed => None,
            Self::NoMesh => Some((
                WearStatus::NoMesh,
                "the machine has no gear mesh, so there is no wear to estimate; the record is like the healthy ones"
                    .to_owned(),
            )),
            Self::Simulating => Some((
                WearStatus::AwaitingLibrary,
                "the library of the gear pair is being simulated; the wear estimate follows".to_owned(),
            )),
            Self::Failed(reason) => Some((
                WearStatus::LibraryFailed,
                format!("the library of the gear pair could not be simulated: {reason}"),
            )),
        }
    }

    /// Sets the status and reason of an estimate that has no other result.
    pub(super) fn apply_to(&self, wear: &mut WearEstimate) {
        let is_open = match wear.status {
            WearStatus::NoLibrary => true,
            // A library that is awaited takes precedence over the baseline; without a mesh none is awaited.
            WearStatus::CollectingBaseline => *self != Self::NoMesh,
            _ => false,
        };
        if let Some((status, reason)) = self.status_and_reason().filter(|_| is_open) {
            (wear.status, wear.reason) = (status, reason);
        }
    }
}

/// Progress of the healthy baseline.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct BaselineProgress {
    /// Records collected.
    pub have: u32,
    /// Records needed.
    pub need: u32,
}

/// The library state that explains the record best.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct BestState {
    /// Its index in the library.
    pub index: usize,
    /// Its greatest wear depth in µm.
    pub wear_um: f64,
    /// Index of the ensemble's member that explains it.
    #[serde(default)]
    pub member: usize,
}

/// A median with its 5 % and 95 % quantiles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Interval {
    /// Median.
    pub median: f64,
    /// 5 % quantile.
    pub p05: f64,
    /// 95 % quantile.
    pub p95: f64,
}

/// Probability of each wear depth on the tracking grid.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Posterior {
    /// Wear depths in µm.
    pub wear_um: Vec<f64>,
    /// Probability of each; the sum is 1.
    pub probability: Vec<f64>,
}

/// Greatest wear depth over the flank with its 90 % interval, or the reason why there is none.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct WearEstimate {
    /// Status of the estimate.
    pub status: WearStatus,
    /// The result or its absence in words, with the numbers that matter.
    pub reason: String,
    /// For a record that cannot be compared, what it has and what is needed, in a few words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub short_reason: Option<String>,
    /// Progress of the baseline.
    pub baseline: BaselineProgress,
    /// Median wear depth in µm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub median_um: Option<f64>,
    /// Mean wear depth in µm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean_um: Option<f64>,
    /// Lower end in µm of the interval that contains the wear depth with 90 % probability.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub low_um: Option<f64>,
    /// 25 % quantile of wear depth in µm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p25_um: Option<f64>,
    /// 75 % quantile of wear depth in µm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p75_um: Option<f64>,
    /// Upper end in µm of this interval; the 95 % quantile if it begins at 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub high_um: Option<f64>,
    /// Transmission error that the wear adds under load, peak to peak in µm along the line of action. This is
    /// what the mesh lines respond to, similar for wear shapes whose greatest depths differ by a factor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transmission_error_um: Option<Interval>,
    /// Depth in µm reached with 95 % probability, where the interval extends to the end of the library.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_least_um: Option<f64>,
    /// Probability that wear has passed the user's limit; absent if the limit and the interval's end lie
    /// beyond the library.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub above_limit: Option<f64>,
    /// Natural logarithm of this record's evidence under the library.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub log_evidence: Option<f64>,
    /// The library state that explains this record best.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub best_state: Option<BestState>,
    /// Range of depths in µm that this record cannot resolve at its operating point: within it, the library
    /// changes less than its own error and the scatter of one record.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resolved_um: Option<[f64; 2]>,
    /// How well the best state explains the record.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub novelty: Option<Novelty>,
    /// Rate of wear and time to the user's limit; absent until the rate is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prognosis: Option<Prognosis>,
    /// Hash of the library that the record was compared with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub library_id: Option<String>,
    /// Hash of the ensemble around that library.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ensemble_id: Option<String>,
    /// Identifier of the features' preprocessing and of the estimator.
    pub method: String,
    /// The whole posterior; left out of histories.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub posterior: Option<Posterior>,
}

impl WearEstimate {
    /// Returns the median depth in µm of a final estimate that determines the depth; `None` for a provisional
    /// one, and for one whose interval covers most of the library.
    pub fn determined_depth_um(&self) -> Option<f64> {
        self.median_um.filter(|_| self.status == WearStatus::Estimated)
    }

    /// Marks the result of a comparison as a first estimate from a part of the library. A depth is kept; a
    /// record that this part does not explain is left unjudged.
    pub(super) fn make_provisional(&mut self) {
        match self.status {
            WearStatus::Estimated | WearStatus::NotIdentifiable => {
                self.reason = format!("first estimate from a part of the library: {}", self.reason);
            }
            WearStatus::OutsideLibrary => {
                "the part of the library simulated so far does not explain this record"
                    .clone_into(&mut self.reason);
                self.novelty = None;
            }
            _ => return,
        }
        self.status = WearStatus::Provisional;
    }

    /// Adds the doubt about a given speed to the estimate of a first record: it asks whether teeth and speed
    /// are right before the baseline is complete.
    pub(super) fn ask_about_speed(&mut self, features: &Features) {
        let is_early = matches!(self.status, WearStatus::CollectingBaseline | WearStatus::AwaitingLibrary);
        if let Some(doubt) = features.given_speed_doubt.as_ref().filter(|_| is_early) {
            self.reason = format!("{}; {doubt}", self.reason);
        }
    }

    /// Returns the values that are followed over time as indicators: `novelty`, where there is one.
    pub fn indicators(&self) -> Indicators {
        let novelty = self.novelty.iter().map(|novelty| ("novelty".to_owned(), novelty.score));
        Indicators { values: novelty.collect(), ..Indicators::default() }
    }

    /// Creates an estimate without a wear depth.
    pub fn without_number(status: WearStatus, reason: String, baseline: BaselineProgress) -> Self {
        Self { status, reason, baseline, method: format!("{METHOD}/{PREPROCESSING}"), ..Self::default() }
    }
}
