//! From features to wear: the healthy baseline, the likelihood of each wear depth, the tracking of wear over
//! time, novelty (changes that are not wear), the time to a limit, and alarms.
//!
//! Everything here is pure and deterministic: an estimate is a fold over an asset's features and maintenance
//! events in time order. Features are taken relative to the asset's own healthy baseline, so that an unknown
//! linear transmission path cancels.

mod alarm;
mod anchor;
mod baseline;
mod channel;
mod common_movement;
mod comparability;
mod cusum;
mod depth_grid;
mod deviation;
mod discrepancy;
mod event;
mod expectation;
mod exponential;
mod extrapolation;
mod filter;
mod groups;
mod growth;
mod growth_clock;
mod healthy;
mod healthy_checks;
mod healthy_lines;
mod joint;
mod joint_posterior;
mod levels;
mod likelihood;
mod line_motion;
mod load;
mod measured_lines;
mod novelty;
mod packed;
mod prognosis;
mod sudden_change;
mod tracker;
mod transmission_error;
mod trend;
mod wear;

pub use alarm::{
    ActionTaken, Alarm, AlarmAction, AlarmChange, AlarmError, AlarmPanel, AlarmQuantity, AlarmReading,
    AlarmRule, AlarmSettings, AlarmState, PanelAction, PanelChange, RatedQuantity, Severity,
};
pub use channel::{ChannelEstimator, ChannelState, RecordResult};
pub use event::{Inspection, MaintenanceEvent, MaintenanceKind};
pub use joint::{ChannelContribution, JointEstimate, RecordTimes};
pub use novelty::{FeatureDeviation, Novelty, SensorFault, SuspectedFault};
pub use prognosis::Prognosis;
pub use tracker::{EstimatorSettings, HistoryStep, Tracker, TrackerState};
pub use wear::{
    BaselineProgress, BestState, Interval, METHOD, MissingLibrary, Posterior, WearEstimate, WearStatus,
};
