//! Other names and units for the channels of a recording that names them itself.

use std::collections::{BTreeMap, BTreeSet};

use super::channel_units::ChannelUnits;
use crate::recording::Recorded;
use crate::service::error::ServiceError;

/// New names of a recording's channels, and units for samples without one; other channels keep their names.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ChannelNames {
    by_recorded: BTreeMap<String, NewName>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct NewName {
    name: String,
    unit: Option<String>,
}

impl ChannelNames {
    /// The channels named `recorded` in the recording get `names`, and `units` where their samples have none;
    /// all lists are in the same order, `units` may be empty, and so may each of its entries.
    ///
    /// # Errors
    /// The lists differ in length; a name is given twice.
    pub fn new(recorded: &[String], names: &[String], units: &[String]) -> Result<Self, ServiceError> {
        let refuse = |field, list: &[String], expected: &'static str| {
            Err(ServiceError::Field { field, value: format!("{list:?}"), expected: expected.into() })
        };
        if recorded.len() != names.len() {
            return refuse("recorded_channels", recorded, "as many names as channel_names has");
        }
        if !units.is_empty() && units.len() != names.len() {
            return refuse("channel_units", units, "as many units as channel_names has names");
        }
        for (field, list) in [("recorded_channels", recorded), ("channel_names", names)] {
            if (1..list.len()).any(|n| list[..n].contains(&list[n])) {
                return refuse(field, list, "each name at most once");
            }
        }
        let units = units.iter().map(Some).chain(std::iter::repeat(None));
        let by_recorded = recorded.iter().zip(names).zip(units).map(|((recorded, name), unit)| {
            let unit = unit.filter(|unit| !unit.is_empty()).cloned();
            (recorded.clone(), NewName { name: name.clone(), unit })
        });
        Ok(Self { by_recorded: by_recorded.collect() })
    }

    /// The units of samples without one, by the channel's name in the recording: the given one, else that of
    /// the channel whose name they get.
    pub(crate) fn units(&self, known: &ChannelUnits) -> BTreeMap<String, String> {
        let by_channel: BTreeMap<String, String> = known.by_channel().collect();
        let of_renamed = self.by_recorded.iter().filter_map(|(recorded, new)| {
            let unit = new.unit.as_ref().or_else(|| by_channel.get(&new.name))?;
            Some((recorded.clone(), unit.clone()))
        });
        of_renamed.collect()
    }

    /// The names in the recording of the channels that get another one.
    pub(crate) fn recorded(&self) -> BTreeSet<String> {
        self.by_recorded.keys().cloned().collect()
    }

    /// A record under its new name.
    pub(crate) fn applied_to(&self, recorded: Recorded) -> Recorded {
        match self.by_recorded.get(recorded.record.channel()) {
            Some(new) => Recorded { record: recorded.record.with_channel(&new.name), ..recorded },
            None => recorded,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list(names: &[&str]) -> Vec<String> {
        names.iter().map(|&name| name.to_owned()).collect()
    }

    #[test]
    fn lists_must_agree_and_name_each_channel_once() {
        let refused = |recorded: &[&str], names: &[&str], units: &[&str]| {
            ChannelNames::new(&list(recorded), &list(names), &list(units)).unwrap_err().to_string()
        };
        assert!(refused(&["x"], &[], &[]).contains("recorded_channels"));
        assert!(refused(&["x", "y"], &["a", "b"], &["g"]).contains("channel_units"));
        assert!(refused(&["x", "y"], &["a", "a"], &[]).contains("channel_names"));
        assert!(ChannelNames::new(&list(&["x", "y"]), &list(&["y", "x"]), &[]).is_ok(), "a swap");
    }

    #[test]
    fn an_empty_unit_is_none() {
        let names = ChannelNames::new(&list(&["x", "y"]), &list(&["a", "b"]), &list(&["g", ""])).unwrap();
        let units = names.units(&ChannelUnits::default());
        assert_eq!(units, BTreeMap::from([("x".to_owned(), "g".to_owned())]));
    }
}
