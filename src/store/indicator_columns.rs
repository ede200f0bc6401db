//! Indicators of one record after the other, read from their JSON straight into columns: a history of 10⁵ records has no time for maps
//! of names.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;

use serde::de::{DeserializeSeed, Error, IgnoredAny, MapAccess, Visitor};

use super::StoreError;

/// Puts what a text of [`Indicators`](crate::signal::Indicators) says down at `position` of each indicator's column. Columns that are
/// shorter are filled up with NaN; a value that is there already is replaced, by NaN where the text says that the indicator is absent.
pub(super) fn read(text: &str, position: usize, columns: &mut BTreeMap<String, Vec<f64>>, of: &str) -> Result<(), StoreError> {
    let mut deserializer = serde_json::Deserializer::from_str(text);
    let read = Row { position, columns }
        .deserialize(&mut deserializer)
        .and_then(|()| deserializer.end());
    read.map_err(|source| StoreError::Damaged {
        what: "indicators",
        of: of.to_string(),
        source,
    })
}

/// A text as a whole.
struct Row<'a> {
    position: usize,
    columns: &'a mut BTreeMap<String, Vec<f64>>,
}

impl<'de> DeserializeSeed<'de> for Row<'_> {
    type Value = ();

    fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for Row<'_> {
    type Value = ();

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("indicators")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        let Row { position, columns } = self;
        let mut has_values = false;
        while let Some(key) = map.next_key::<Cow<'de, str>>()? {
            match key.as_ref() {
                "indicators" => {
                    has_values = true;
                    map.next_value_seed(Values { position, columns })?;
                }
                "absent" => map.next_value_seed(Absent { position, columns })?,
                _ => {
                    map.next_value::<IgnoredAny>()?;
                }
            }
        }
        if has_values {
            Ok(())
        } else {
            Err(A::Error::missing_field("indicators"))
        }
    }
}

/// Value by name.
struct Values<'a> {
    position: usize,
    columns: &'a mut BTreeMap<String, Vec<f64>>,
}

impl<'de> DeserializeSeed<'de> for Values<'_> {
    type Value = ();

    fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for Values<'_> {
    type Value = ();

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("values by the names of indicators")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        while let Some((name, value)) = map.next_entry::<Cow<'de, str>, f64>()? {
            let column = match self.columns.get_mut(name.as_ref()) {
                Some(column) => column,
                None => self.columns.entry(name.into_owned()).or_default(),
            };
            column.resize(self.position, f64::NAN);
            column.push(value);
        }
        Ok(())
    }
}

/// Reason by the name of an indicator that is missing.
struct Absent<'a> {
    position: usize,
    columns: &'a mut BTreeMap<String, Vec<f64>>,
}

impl<'de> DeserializeSeed<'de> for Absent<'_> {
    type Value = ();

    fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for Absent<'_> {
    type Value = ();

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("reasons by the names of indicators")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        while let Some((name, IgnoredAny)) = map.next_entry::<Cow<'de, str>, IgnoredAny>()? {
            // A shorter column has none at this position anyway.
            if let Some(value) = self.columns.get_mut(name.as_ref()).and_then(|column| column.get_mut(self.position)) {
                *value = f64::NAN;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::Indicators;

    #[test]
    fn columns_hold_what_the_indicators_of_each_record_say() {
        // Each record's own text, and what the run up to it adds.
        let texts = [
            (r#"{"indicators":{"rms":1.5,"oil":0.1},"absent":{}}"#, None),
            (
                r#"{"indicators":{"rms":2.5,"na4":7.0}}"#,
                Some(r#"{"indicators":{"na4":3.0},"absent":{"rms":"too_short"}}"#),
            ),
            (
                r#"{"absent":{"oil":"too_short"},"indicators":{},"later":[1,{"a":2}]}"#,
                Some(r#"{"indicators":{"\u006ea4":4.0}}"#),
            ),
        ];
        let mut columns = BTreeMap::new();
        for (position, (own, run)) in texts.iter().enumerate() {
            read(own, position, &mut columns, "a").unwrap();
            let mut whole: Indicators = serde_json::from_str(own).unwrap_or_default();
            if let Some(run) = run {
                read(run, position, &mut columns, "a").unwrap();
                whole.extend(serde_json::from_str(run).unwrap_or_default());
            }
            for (name, column) in &columns {
                let value = column.get(position).copied().filter(|value| !value.is_nan());
                assert_eq!(value, whole.values.get(name).copied(), "{name} of record {position}");
            }
        }
        assert_eq!(columns.keys().collect::<Vec<_>>(), ["na4", "oil", "rms"]);
        for damaged in [
            "{}",
            r#"{"indicators":{"rms":null}}"#,
            r#"{"indicators":{}} x"#,
            r#"{"indicators":[]}"#,
            "",
            "{\"indicators\":{",
        ] {
            assert!(
                matches!(read(damaged, 3, &mut columns, "a"), Err(StoreError::Damaged { .. })),
                "{damaged}"
            );
        }
    }
}
