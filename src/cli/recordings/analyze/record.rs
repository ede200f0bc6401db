//! An analysed record.

use std::collections::BTreeMap;

use jiff::Timestamp;
use serde::Serialize;

use super::envelope::AnalyzedEnvelope;
use crate::asset::{VelocityZone, json_name};
use crate::estimate::WearEstimate;
use crate::report::ReportedRecord;
use crate::signal::{Basis, Features, Indicators, ShaftSpeed, SpeedDoubt, SpeedSource};

/// An analysed record, as it is printed.
#[derive(Debug, Serialize)]
pub(super) struct AnalyzedRecord {
    pub(super) file: String,
    pub(super) channel: String,
    /// None if the recording has no time.
    pub(super) start_time: Option<Timestamp>,
    /// The start time, or one that counts from 1970.
    #[serde(skip)]
    pub(super) time: Timestamp,
    pub(super) sample_rate_hz: f64,
    pub(super) samples: usize,
    pub(super) unit: String,
    pub(super) shaft_speed_hz: Option<f64>,
    pub(super) shaft_speed_source: Option<SpeedSource>,
    /// Why the speed or the number of teeth may be wrong.
    pub(super) shaft_speed_doubt: Option<SpeedDoubt>,
    pub(super) mesh_frequency_hz: Option<f64>,
    #[serde(flatten)]
    pub(super) basis: Basis,
    #[serde(flatten)]
    pub(super) indicators: Indicators,
    /// The zone of the velocity, if the asset has zones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) velocity_zone: Option<VelocityZone>,
    /// The envelope spectrum, if requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) envelope: Option<AnalyzedEnvelope>,
    /// The wear estimate with its status, whether or not it has a depth; null without an asset description.
    pub(super) wear: Option<WearEstimate>,
    /// The estimate in words, or the reason why there is none.
    pub(super) wear_reason: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) reference_wear_um: Option<f64>,
    /// Whether the described machine has a gear mesh.
    #[serde(skip)]
    pub(super) has_mesh: bool,
    /// Whether a gear pair is described, without which no wear is estimated.
    #[serde(skip)]
    pub(super) has_pair: bool,
    /// The shaft speed with its support.
    #[serde(skip)]
    pub(super) shaft_speed: Option<ShaftSpeed>,
    #[serde(skip)]
    pub(super) features: Features,
}

impl AnalyzedRecord {
    /// Formats the start time, or the time since the first recording began.
    pub(super) fn time_text(&self) -> String {
        match self.start_time {
            Some(time) => time.strftime("%m-%d %H:%M:%S").to_string(),
            None => {
                let seconds = self.time.as_second();
                format!("+{}:{:02}:{:02}", seconds / 3600, seconds / 60 % 60, seconds % 60)
            }
        }
    }

    /// Returns the name of the status; `None` without an asset description.
    pub(super) fn status(&self) -> Option<String> {
        self.wear.as_ref().map(|wear| json_name(&wear.status))
    }

    /// Returns the name of what wear does not explain: the sensor fault or, without one, the suspected fault.
    pub(super) fn cause(&self) -> Option<String> {
        let novelty = self.wear.as_ref()?.novelty.as_ref()?;
        let suspected = || novelty.suspected_fault.as_ref().map(json_name);
        novelty.sensor_fault.as_ref().map(json_name).or_else(suspected)
    }
}

/// Groups records by channel, each channel in time order.
pub(super) fn by_channel(records: &[AnalyzedRecord]) -> BTreeMap<&str, Vec<&AnalyzedRecord>> {
    let mut channels: BTreeMap<&str, Vec<&AnalyzedRecord>> = BTreeMap::new();
    for record in records {
        channels.entry(&record.channel).or_default().push(record);
    }
    channels.values_mut().for_each(|records| records.sort_by_key(|record| record.time));
    channels
}

impl From<&AnalyzedRecord> for ReportedRecord {
    fn from(record: &AnalyzedRecord) -> Self {
        Self {
            name: record.file.clone(),
            channel: record.channel.clone(),
            start_time: record.time,
            unit: record.unit.clone(),
            shaft_speed_hz: record.shaft_speed_hz,
            indicators: record.indicators.clone(),
            shaft_angle: record.basis.shaft_angle.clone(),
            wear: record.wear.clone(),
            wear_words: record.wear_reason.clone(),
            reference_wear_um: record.reference_wear_um,
        }
    }
}
