//! Names of an enum's values, as in JSON.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Error, Value};

/// The name of a value, such as a segment's status or a cause of it.
pub(crate) fn json_name(value: &impl Serialize) -> String {
    let name = serde_json::to_value(value).ok();
    name.as_ref().and_then(Value::as_str).unwrap_or_default().to_owned()
}

/// The value of a name; the error lists the names.
pub(crate) fn from_json_name<T: DeserializeOwned>(name: &str) -> Result<T, Error> {
    serde_json::from_value(Value::from(name))
}
