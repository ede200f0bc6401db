//! The unit of each channel: that of its stored records, else that of the description, else that of its first
//! record.

use std::collections::HashMap;

use crate::asset::{AssetSpec, MAX_UNIT_BYTES};
use crate::recording::RecordingError;
use crate::service::error::ServiceError;
use crate::signal::{Record, RecordError};
use crate::store::Store;

/// The unit of samples whose unit is unknown.
const UNKNOWN: &str = "1";

/// Units of the channels of an asset.
#[derive(Debug, Clone, Default)]
pub(crate) struct ChannelUnits {
    by_channel: HashMap<String, String>,
    /// Unit of all other channels.
    others: Option<String>,
}

impl ChannelUnits {
    /// The units that a description gives.
    pub(crate) fn described(spec: &AssetSpec) -> Self {
        Self { by_channel: spec.channel_units().into_iter().collect(), others: spec.sensor.unit.clone() }
    }

    /// Reads the known units of an asset's channels.
    pub(crate) async fn load(store: &Store, spec: &AssetSpec) -> Result<Self, ServiceError> {
        let Self { mut by_channel, others } = Self::described(spec);
        for (channel, unit) in store.channel_units(&spec.id).await? {
            // If no unit was given so far, the description may give it later.
            if unit != UNKNOWN {
                by_channel.insert(channel, unit);
            } else if spec.sensor.unit.is_none() {
                by_channel.entry(channel).or_insert(unit);
            }
        }
        Ok(Self { by_channel, others })
    }

    /// Adds what is known of other channels, from earlier records of the same recording that may not be
    /// stored yet.
    pub(crate) fn extend(&mut self, earlier: &Self) {
        for (channel, unit) in &earlier.by_channel {
            self.by_channel.entry(channel.clone()).or_insert_with(|| unit.clone());
        }
    }

    /// The known units by channel name.
    pub(crate) fn by_channel(&self) -> impl Iterator<Item = (String, String)> + '_ {
        let known = self.by_channel.iter().filter(|(_, unit)| *unit != UNKNOWN);
        known.map(|(channel, unit)| (channel.clone(), unit.clone()))
    }

    /// The unit of records that state none, if it is known.
    pub(crate) fn default_of(&self, channel: &str) -> Option<&str> {
        self.by_channel.get(channel).or(self.others.as_ref()).map(String::as_str)
    }

    /// Takes the unit of a channel from its first record if it is unknown so far.
    pub(crate) fn learn_unit(&mut self, record: &Record) {
        if self.others.is_none() && !self.by_channel.contains_key(record.channel()) {
            self.by_channel.insert(record.channel().to_owned(), record.unit().to_owned());
        }
    }

    /// Checks that a channel may have samples in a unit, as [`convert`](Self::convert) does.
    ///
    /// # Errors
    /// The unit is not one, or cannot be converted to that of the channel.
    pub(crate) fn check(&self, channel: &str, unit: &str) -> Result<(), ServiceError> {
        check_unit(unit)?;
        let expected = self.by_channel.get(channel).or(self.others.as_ref());
        match expected.filter(|expected| crate::signal::unit_factor(unit, expected).is_none()) {
            Some(expected) => {
                let (channel, found, expected) = (channel.to_owned(), unit.to_owned(), expected.clone());
                let is_acceleration = crate::signal::unit_factor(&expected, "m/s2").is_some();
                let error = RecordError::Unit { channel, found, expected, is_acceleration };
                Err(RecordingError::from(error).into())
            }
            None => Ok(()),
        }
    }

    /// Converts a record to the unit of its channel. Also returns its original unit if the sample values
    /// changed.
    ///
    /// # Errors
    /// Its unit cannot be converted to that of its channel.
    pub(crate) fn convert(&self, record: Record) -> Result<(Record, Option<String>), ServiceError> {
        let unit = self.by_channel.get(record.channel()).or(self.others.as_ref());
        let Some(unit) = unit.filter(|unit| *unit != record.unit()) else {
            return Ok((record, None));
        };
        let original_unit = record.unit().to_owned();
        let is_same = crate::signal::unit_factor(&original_unit, unit) == Some(1.0);
        let fixed = record.in_unit(unit).map_err(RecordingError::from)?;
        Ok((fixed, (!is_same).then_some(original_unit)))
    }
}

/// Whether a channel cannot have records in both units. Once a unit is known, that of earlier records without
/// one stays unknown.
pub(crate) fn units_conflict(a: &str, b: &str) -> bool {
    a != b && a != UNKNOWN && b != UNKNOWN
}

/// Checks the name of a unit.
pub(super) fn check_unit(unit: &str) -> Result<(), ServiceError> {
    if unit.is_empty() || unit.len() > MAX_UNIT_BYTES || unit.chars().any(char::is_control) {
        return Err(ServiceError::Field {
            field: "unit",
            value: format!("{:?}", unit.chars().take(MAX_UNIT_BYTES).collect::<String>()),
            expected: format!("1 to {MAX_UNIT_BYTES} bytes without control characters").into(),
        });
    }
    Ok(())
}
