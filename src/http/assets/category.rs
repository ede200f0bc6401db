//! An asset's category after NAMUR NE 107, and its numbers of open alarms.

use jiff::Timestamp;
use serde::Serialize;

use crate::asset::WearLimits;
use crate::estimate::{AlarmState, Severity, WearEstimate, WearStatus};
use crate::service::Readiness;
use crate::store::StoredAlarm;

/// An asset's category after NAMUR NE 107.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Category {
    /// Danger, or a faulty sensor.
    Failure,
    /// Plan maintenance.
    MaintenanceRequired,
    /// An assumption of the estimate is violated: the change is not wear, or wear cannot be identified.
    OutOfSpecification,
    /// Not ready yet: collecting the baseline or simulating the library.
    CheckFunction,
    /// No action needed.
    Normal,
    /// No data to judge.
    None,
}

/// An asset's numbers of alarms.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub(crate) struct AlarmCounts {
    /// Raised as danger and not shelved.
    pub(crate) danger: u32,
    /// Raised as warning and not shelved.
    pub(crate) warning: u32,
    /// Unacknowledged, even if cleared, and not shelved.
    pub(crate) unacknowledged: u32,
    /// Shelved.
    pub(crate) shelved: u32,
}

impl AlarmCounts {
    /// Counts alarms by their state at time `now`.
    pub(crate) fn of<'a>(alarms: impl IntoIterator<Item = &'a StoredAlarm>, now: Timestamp) -> Self {
        let mut counts = Self::default();
        for StoredAlarm { alarm, .. } in alarms {
            let state = alarm.state(now);
            if state == AlarmState::Shelved {
                counts.shelved += 1;
                continue;
            }
            counts.danger += u32::from(alarm.severity() == Some(Severity::Danger));
            counts.warning += u32::from(alarm.severity() == Some(Severity::Warning));
            counts.unacknowledged +=
                u32::from(matches!(state, AlarmState::Unacknowledged | AlarmState::ReturnedUnacknowledged));
        }
        counts
    }
}

impl Category {
    /// The category for these alarms, this latest wear and this library. Pass only `limits` that
    /// no alarm watches.
    pub(crate) fn of(
        alarms: AlarmCounts,
        wear: Option<&WearEstimate>,
        limits: WearLimits,
        library: &Readiness,
    ) -> Self {
        let beyond = |limit: Option<f64>| {
            limit.zip(wear.and_then(WearEstimate::determined_depth_um)).is_some_and(|(limit, um)| um >= limit)
        };
        let status = wear.map(|wear| wear.status);
        if alarms.danger > 0 || beyond(limits.danger_um) || status == Some(WearStatus::SensorFault) {
            return Self::Failure;
        }
        if alarms.warning > 0 || beyond(limits.warning_um) {
            return Self::MaintenanceRequired;
        }
        if matches!(library, Readiness::Failed(_)) {
            return Self::OutOfSpecification;
        }
        match status {
            Some(WearStatus::Estimated | WearStatus::NoMesh) => Self::Normal,
            Some(
                WearStatus::OutsideLibrary
                | WearStatus::NotIdentifiable
                | WearStatus::NotComparable
                | WearStatus::NoFeatures
                | WearStatus::SpeedInDoubt
                | WearStatus::LibraryFailed,
            ) => Self::OutOfSpecification,
            Some(
                WearStatus::CollectingBaseline
                | WearStatus::AwaitingLibrary
                | WearStatus::Provisional
                | WearStatus::Recomputing,
            ) => Self::CheckFunction,
            _ if matches!(library, Readiness::Building) => Self::CheckFunction,
            Some(WearStatus::NoLibrary | WearStatus::SensorFault | WearStatus::Excluded) | None => Self::None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::BaselineProgress;

    fn wear(status: WearStatus, median_um: Option<f64>) -> WearEstimate {
        let baseline = BaselineProgress { have: 8, need: 8 };
        WearEstimate { median_um, ..WearEstimate::without_number(status, String::new(), baseline) }
    }

    #[test]
    fn alarms_take_precedence_over_the_status() {
        let raised = |danger, warning| AlarmCounts { danger, warning, ..AlarmCounts::default() };
        let limits = WearLimits { warning_um: Some(100.0), danger_um: Some(200.0) };
        let none = WearLimits::default();
        let estimated = wear(WearStatus::Estimated, Some(150.0));
        let failed = Readiness::Failed("bad".into());
        for (alarms, wear, limits, library, category) in [
            (raised(1, 1), Some(&estimated), none, &Readiness::None, Category::Failure),
            (raised(0, 1), Some(&estimated), none, &Readiness::None, Category::MaintenanceRequired),
            (raised(0, 0), Some(&estimated), limits, &Readiness::None, Category::MaintenanceRequired),
            (raised(0, 0), Some(&estimated), none, &Readiness::None, Category::Normal),
            (
                raised(0, 0),
                Some(&wear(WearStatus::SensorFault, None)),
                none,
                &Readiness::None,
                Category::Failure,
            ),
            (
                raised(0, 0),
                Some(&wear(WearStatus::OutsideLibrary, None)),
                none,
                &Readiness::None,
                Category::OutOfSpecification,
            ),
            (
                raised(0, 0),
                Some(&wear(WearStatus::CollectingBaseline, None)),
                none,
                &Readiness::None,
                Category::CheckFunction,
            ),
            (raised(0, 0), Some(&wear(WearStatus::NoLibrary, None)), none, &Readiness::None, Category::None),
            (raised(0, 0), Some(&wear(WearStatus::NoMesh, None)), none, &Readiness::None, Category::Normal),
            (raised(0, 0), None, none, &Readiness::Building, Category::CheckFunction),
            (raised(0, 0), None, none, &failed, Category::OutOfSpecification),
            (raised(0, 0), None, none, &Readiness::None, Category::None),
        ] {
            assert_eq!(Category::of(alarms, wear, limits, library), category, "{alarms:?} {wear:?}");
        }
    }
}
