//! Reading descriptions from TOML.

use serde::de::{DeserializeOwned, Error};
use serde_path_to_error::{Path, Segment};
use toml::{Table, Value};

/// Why a text is not the description that was expected.
#[derive(Debug, thiserror::Error)]
#[error("{source}")]
pub struct DescriptionError {
    /// Path of the value at fault; `None` if the text is not TOML.
    pub path: Option<String>,
    /// The error, with the place in the text if it is known.
    pub source: Box<toml::de::Error>,
}

/// Reads a description from TOML, with exactly as many elements in each list as a field has.
///
/// # Errors
/// The text is not TOML, or a field is missing, unknown, of the wrong type or too long.
pub fn from_toml<T: DeserializeOwned>(text: &str) -> Result<T, DescriptionError> {
    let no_toml = |source: toml::de::Error| DescriptionError { path: None, source: source.into() };
    let reader = toml::Deserializer::parse(text).map_err(no_toml)?;
    let read: T = serde_path_to_error::deserialize(reader).map_err(|error| DescriptionError {
        path: Some(error.path().to_string()),
        source: Box::new(error.into_inner()),
    })?;
    // From the text, what follows the last element of an array is ignored; from values it is an error.
    let table: Table = toml::from_str(text).map_err(no_toml)?;
    match strict_path::<T>(&table) {
        Ok(()) => Ok(read),
        Err((path, error)) => {
            let source = too_long::<T>(table, &path).map_or(error, toml::de::Error::custom);
            Err(DescriptionError { path: Some(path.to_string()), source: source.into() })
        }
    }
}

/// Reads a description from values; returns where it fails.
fn strict_path<T: DeserializeOwned>(table: &Table) -> Result<(), (Path, toml::de::Error)> {
    let read: Result<T, _> = serde_path_to_error::deserialize(Value::Table(table.clone()));
    read.map(|_| ()).map_err(|error| (error.path().clone(), error.into_inner()))
}

/// Describes the list at a path, which has too many elements.
fn too_long<T: DeserializeOwned>(mut table: Table, path: &Path) -> Option<String> {
    let found = list_at(&mut table, path)?.clone();
    let text = path.to_string();
    for length in (0..found.len()).rev() {
        list_at(&mut table, path)?.truncate(length);
        if strict_path::<T>(&table).err().is_none_or(|(path, _)| path.to_string() != text) {
            let shown = Value::Array(found);
            return Some(format!("{text} is {shown}, expected {length} values"));
        }
    }
    None
}

fn list_at<'a>(table: &'a mut Table, path: &Path) -> Option<&'a mut Vec<Value>> {
    let mut segments = path.iter();
    let mut value = table.get_mut(&key_of(segments.next()?)?)?;
    for segment in segments {
        value = match segment {
            Segment::Seq { index } => value.get_mut(*index)?,
            segment => value.get_mut(key_of(segment)?)?,
        };
    }
    value.as_array_mut()
}

fn key_of(segment: &Segment) -> Option<String> {
    match segment {
        Segment::Map { key } => Some(key.clone()),
        Segment::Enum { variant } => Some(variant.clone()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, Deserialize, PartialEq)]
    #[serde(rename_all = "snake_case")]
    enum Zones {
        Limits([f64; 3]),
    }

    #[derive(Debug, Deserialize, PartialEq)]
    struct Part {
        band: [f64; 2],
    }

    #[derive(Debug, Deserialize, PartialEq)]
    struct Whole {
        teeth: [u32; 2],
        zones: Option<Zones>,
        #[serde(default)]
        parts: Vec<Part>,
    }

    #[test]
    fn lists_have_as_many_values_as_their_fields() {
        let rest = "zones = { limits = [1, 2, 3] }\n[[parts]]\nband = [1, 2]";
        let read: Whole = from_toml(&format!("teeth = [20, 40]\n{rest}")).unwrap();
        assert_eq!((read.teeth, read.parts.len()), ([20, 40], 1));
        for (text, path, message) in [
            ("teeth = [20, 40, 60]", "teeth", "teeth is [20, 40, 60], expected 2 values"),
            (
                "teeth = [20, 40]\nzones = { limits = [1.0, 2.0, 3.0, 4.0, 5.0] }",
                "zones.limits",
                "zones.limits is [1.0, 2.0, 3.0, 4.0, 5.0], expected 3 values",
            ),
            (
                "teeth = [20, 40]\nparts = [{ band = [1, 2] }, { band = [1, 2, 3] }]",
                "parts[1].band",
                "parts[1].band is [1, 2, 3], expected 2 values",
            ),
            ("teeth = [20]", "teeth", "invalid length 1"),
            ("teeth = [20, -1]", "teeth[1]", "invalid value"),
        ] {
            let error = from_toml::<Whole>(text).unwrap_err();
            assert!(error.to_string().contains(message), "{error}");
            assert_eq!(error.path.as_deref(), Some(path), "{error}");
        }
        assert_eq!(from_toml::<Whole>("teeth = [").unwrap_err().path, None);
    }
}
