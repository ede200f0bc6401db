//! Conversions between rows and domain types.

use jiff::{Timestamp, TimestampArithmetic};
use serde::Serialize;
use serde::de::DeserializeOwned;
use sqlx::any::AnyRow;
use sqlx::{Decode, Row, Type};

use crate::asset::{AssetId, from_json_name};
use crate::store::StoreError;

/// The value of a column.
pub(in crate::store) fn get<'r, T>(row: &'r AnyRow, column: &'static str) -> Result<T, StoreError>
where
    T: Decode<'r, sqlx::Any> + Type<sqlx::Any>,
{
    Ok(row.try_get(column)?)
}

/// The value of a column that counts something.
pub(in crate::store) fn get_count(row: &AnyRow, column: &'static str) -> Result<u64, StoreError> {
    let value: i64 = get(row, column)?;
    u64::try_from(value).map_err(|_| StoreError::Unexpected {
        what: column,
        value: value.to_string(),
        expected: "a number of at least 0",
    })
}

/// The time in a column of nanoseconds.
pub(in crate::store) fn get_time(row: &AnyRow, column: &'static str) -> Result<Timestamp, StoreError> {
    Ok(from_ns(get(row, column)?))
}

/// Decodes the JSON text of a column; `of` names the row in the error.
pub(in crate::store) fn get_json<T: DeserializeOwned>(
    row: &AnyRow,
    column: &'static str,
    of: &str,
) -> Result<T, StoreError> {
    let text: String = get(row, column)?;
    from_json(&text, column, of)
}

/// The value whose name is in a column; `of` names the row in the error.
pub(in crate::store) fn get_named<T: DeserializeOwned>(
    row: &AnyRow,
    column: &'static str,
    of: &str,
) -> Result<T, StoreError> {
    let name: String = get(row, column)?;
    from_json_name(&name).map_err(StoreError::damaged(column, of))
}

/// Decodes the JSON text of a column that is null in older rows.
pub(in crate::store) fn get_json_or_default<T: DeserializeOwned + Default>(
    row: &AnyRow,
    column: &'static str,
    of: &str,
) -> Result<T, StoreError> {
    let text: Option<String> = get(row, column)?;
    text.map_or_else(|| Ok(T::default()), |text| from_json(&text, column, of))
}

/// Decodes a JSON text.
pub(in crate::store) fn from_json<T: DeserializeOwned>(
    text: &str,
    what: &'static str,
    of: &str,
) -> Result<T, StoreError> {
    serde_json::from_str(text).map_err(StoreError::damaged(what, of))
}

/// Encodes a value as JSON text; `of` names the row in the error.
pub(in crate::store) fn to_json<T: Serialize>(
    value: &T,
    what: &'static str,
    of: &str,
) -> Result<String, StoreError> {
    serde_json::to_string(value).map_err(StoreError::damaged(what, of))
}

/// Converts a stored asset name.
pub(in crate::store) fn asset_id(name: String) -> Result<AssetId, StoreError> {
    AssetId::new(name).map_err(|error| StoreError::Unexpected {
        what: "asset_id",
        value: error.to_string(),
        expected: "an asset's name",
    })
}

/// Nanoseconds UTC of a time.
pub(in crate::store) fn to_ns(time: Timestamp) -> Result<i64, StoreError> {
    i64::try_from(time.as_nanosecond()).map_err(|_| StoreError::Time(time))
}

/// The end of a lease that begins now.
pub(in crate::store) fn lease_end(now: Timestamp, lease: impl Into<TimestampArithmetic>) -> Timestamp {
    now.saturating_add(lease).unwrap_or(Timestamp::MAX)
}

/// The time of nanoseconds UTC; every `i64` is one.
pub(in crate::store) fn from_ns(nanoseconds: i64) -> Timestamp {
    Timestamp::from_nanosecond(i128::from(nanoseconds)).unwrap_or_default()
}

/// Refuses a number that no database should hold.
pub(in crate::store) fn finite(field: &str, value: f64) -> Result<f64, StoreError> {
    if value.is_finite() { Ok(value) } else { Err(StoreError::NotFinite { field: field.to_string(), value }) }
}

/// Checks an optional number.
pub(in crate::store) fn finite_or_none(field: &str, value: Option<f64>) -> Result<Option<f64>, StoreError> {
    value.map(|value| finite(field, value)).transpose()
}

/// `$first, $first+1, …` for `count` values of an IN list.
pub(in crate::store) fn placeholders(first: usize, count: usize) -> String {
    let list: Vec<String> = (first..first + count).map(|n| format!("${n}")).collect();
    list.join(", ")
}

/// `($1, $2), ($3, $4), …`: `rows` rows of `columns` values.
pub(in crate::store) fn rows_of_placeholders(rows: usize, columns: usize) -> String {
    let row = |n: usize| format!("({})", placeholders(n * columns + 1, columns));
    (0..rows).map(row).collect::<Vec<_>>().join(", ")
}

/// `(a = $1 AND b = $2) OR (a = $3 AND b = $4) OR …` for terms `a =` and `b =`. Not `(a, b) IN (VALUES …)`,
/// for which SQLite reads the whole table.
pub(in crate::store) fn any_of(rows: usize, terms: &[&str]) -> String {
    let row = |n: usize| {
        let terms = (n * terms.len() + 1..).zip(terms).map(|(place, term)| format!("{term} ${place}"));
        format!("({})", terms.collect::<Vec<_>>().join(" AND "))
    };
    (0..rows).map(row).collect::<Vec<_>>().join(" OR ")
}

/// `a = excluded.a, b = excluded.b, …` for columns `a, b, …`: an existing row takes the values of the
/// rejected insert.
pub(in crate::store) fn excluded(columns: &str) -> String {
    let set: Vec<String> =
        columns.split(", ").map(|column| format!("{column} = excluded.{column}")).collect();
    set.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn placeholders_are_numbered_across_rows() {
        assert_eq!(rows_of_placeholders(2, 3), "($1, $2, $3), ($4, $5, $6)");
        assert_eq!(any_of(2, &["a =", "b >="]), "(a = $1 AND b >= $2) OR (a = $3 AND b >= $4)");
        assert_eq!(excluded("a, b"), "a = excluded.a, b = excluded.b");
    }

    #[test]
    fn times_round_trip() {
        for ns in [i64::MIN, -1, 0, 1, i64::MAX] {
            assert_eq!(to_ns(from_ns(ns)).unwrap(), ns);
        }
        assert!(matches!(to_ns(Timestamp::MAX), Err(StoreError::Time(_))));
    }
}
