//! Structured values as columns: their numbers are stored with each record, and their layout (names and
//! structure) only once.
//!
//! The indicators and features of a record are some 150 numbers with as many names, and nearly all records of
//! a machine have the same names. As JSON they take 5 kB, as columns 1 kB.

pub(super) mod filled;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use sha2::{Digest, Sha256};
use sqlx::any::AnyRow;
use sqlx::{Any, Executor};

use crate::estimate::Posterior;
use crate::store::StoreError;
use crate::store::database::rows::{from_json, get, placeholders, rows_of_placeholders, to_json};
use crate::store::transaction::{ROWS_PER_STATEMENT, Transaction};

/// First byte of a value in columns; a value as JSON begins with another one.
const COLUMNS: u8 = 1;

/// Bytes before the numbers: the first one, and the identifier of the layout.
const HEAD: usize = 9;

/// Maximum number of cached layouts; the cache is then cleared.
const MAX_CACHED: usize = 4096;

/// Layouts that are known to be stored, by identifier.
#[derive(Debug, Default)]
pub(in crate::store) struct LayoutCache(Mutex<HashMap<i64, Arc<Value>>>);

/// The layouts of some rows.
pub(in crate::store) struct Layouts(HashMap<i64, Arc<Value>>);

/// A value in columns, to be written.
pub(in crate::store) struct Columns {
    /// The layout and its identifier.
    layout: (i64, String),
    /// The bytes of the row.
    pub(in crate::store) bytes: Vec<u8>,
}

impl Columns {
    /// Splits a value into its layout and its numbers and texts; `of` names the row in the error.
    ///
    /// In the layout `0.5` stands for each floating-point number and `""` for each text. Integers, which
    /// are the same for most records, are part of it.
    pub(in crate::store) fn of<T: Serialize>(
        value: &T,
        what: &'static str,
        of: &str,
    ) -> Result<Self, StoreError> {
        let value = serde_json::to_value(value).map_err(StoreError::damaged(what, of))?;
        let (mut numbers, mut texts) = (Vec::new(), Vec::new());
        let layout = to_json(&split(value, &mut numbers, &mut texts), what, of)?;
        numbers.append(&mut texts);
        Ok(Self::with(layout, &numbers))
    }

    /// Values that all records with the same `layout` have, and numbers of this record alone.
    pub(in crate::store) fn of_numbers(layout: String, numbers: &[f64]) -> Self {
        let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        Self::with(layout, &bytes)
    }

    fn with(layout: String, content: &[u8]) -> Self {
        let id = i64::from_le_bytes(Sha256::digest(layout.as_bytes())[..8].try_into().unwrap_or_default());
        let mut bytes = Vec::with_capacity(HEAD + content.len());
        bytes.push(COLUMNS);
        bytes.extend(id.to_le_bytes());
        bytes.extend(content);
        Self { layout: (id, layout), bytes }
    }
}

/// Takes the numbers and texts out of a value. Texts are preceded by their length.
fn split(value: Value, numbers: &mut Vec<u8>, texts: &mut Vec<u8>) -> Value {
    match value {
        Value::Number(number) if number.is_f64() => {
            numbers.extend(number.as_f64().unwrap_or(f64::NAN).to_le_bytes());
            Value::from(0.5)
        }
        Value::String(text) => {
            texts.extend(u32::try_from(text.len()).unwrap_or(u32::MAX).to_le_bytes());
            texts.extend(text.as_bytes());
            Value::from("")
        }
        Value::Array(items) => {
            items.into_iter().map(|item| split(item, numbers, texts)).collect::<Vec<_>>().into()
        }
        Value::Object(entries) => {
            let entries = entries.into_iter().map(|(name, entry)| (name, split(entry, numbers, texts)));
            Value::Object(entries.collect())
        }
        other => other,
    }
}

/// The identifier of the layout of a value and its content; `None` for a value as JSON.
fn head(bytes: &[u8]) -> Option<(i64, &[u8])> {
    let (head, content) = bytes.split_first_chunk::<HEAD>()?;
    let [COLUMNS, id @ ..] = *head else { return None };
    Some((i64::from_le_bytes(id), content))
}

impl LayoutCache {
    fn lock(&self) -> MutexGuard<'_, HashMap<i64, Arc<Value>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Marks layouts as stored.
    pub(in crate::store) fn add(&self, layouts: impl IntoIterator<Item = (i64, Arc<Value>)>) {
        let mut known = self.lock();
        if known.len() >= MAX_CACHED {
            known.clear();
        }
        known.extend(layouts);
    }

    /// The layouts of these columns of rows; those that are not in memory are read from the database.
    pub(in crate::store) async fn load<'e>(
        &self,
        rows: &[AnyRow],
        columns: &[&'static str],
        executor: impl Executor<'e, Database = Any>,
    ) -> Result<Layouts, StoreError> {
        let mut ids = BTreeSet::new();
        for (row, column) in rows.iter().flat_map(|row| columns.iter().map(move |column| (row, *column))) {
            let bytes: Option<Vec<u8>> = get(row, column)?;
            ids.extend(bytes.as_deref().and_then(head).map(|(id, _)| id));
        }
        let mut found = HashMap::new();
        {
            let known = self.lock();
            found.extend(ids.iter().filter_map(|id| Some((*id, Arc::clone(known.get(id)?)))));
        }
        ids.retain(|id| !found.contains_key(id));
        if ids.is_empty() {
            return Ok(Layouts(found));
        }
        let text = format!("SELECT id, layout FROM layouts WHERE id IN ({})", placeholders(1, ids.len()));
        let query = sqlx::query(&text).persistent(false);
        let query = ids.iter().fold(query, |query, id| query.bind(id));
        let mut read = HashMap::new();
        for row in query.fetch_all(executor).await? {
            let layout = from_json(&get::<String>(&row, "layout")?, "layout", "a record")?;
            read.insert(get(&row, "id")?, Arc::new(layout));
        }
        self.add(read.clone());
        found.extend(read);
        Ok(Layouts(found))
    }
}

impl Layouts {
    /// Decodes a column of one of the rows; `of` names the row in the error.
    pub(in crate::store) fn read<T: DeserializeOwned>(
        &self,
        row: &AnyRow,
        column: &'static str,
        of: &str,
    ) -> Result<T, StoreError> {
        self.decode(&get::<Vec<u8>>(row, column)?, column, of)
    }

    /// Decodes a column that is null in older rows.
    pub(in crate::store) fn read_or_default<T: DeserializeOwned + Default>(
        &self,
        row: &AnyRow,
        column: &'static str,
        of: &str,
    ) -> Result<T, StoreError> {
        let bytes: Option<Vec<u8>> = get(row, column)?;
        bytes.map_or_else(|| Ok(T::default()), |bytes| self.decode(&bytes, column, of))
    }

    /// Decodes the posterior of a row, whose depths are the layout of its probabilities.
    pub(in crate::store) fn read_posterior(
        &self,
        row: &AnyRow,
        of: &str,
    ) -> Result<Option<Posterior>, StoreError> {
        let bytes: Option<Vec<u8>> = get(row, "posterior")?;
        let Some(bytes) = bytes else { return Ok(None) };
        let (depths, content) = self.layout(&bytes, "posterior", of)?;
        let wear_um = serde_json::from_value(depths.clone()).map_err(StoreError::damaged("wear_um", of))?;
        let probability = content.as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
        Ok(Some(Posterior { wear_um, probability }))
    }

    fn layout<'a>(
        &self,
        bytes: &'a [u8],
        what: &'static str,
        of: &str,
    ) -> Result<(&Value, &'a [u8]), StoreError> {
        let unexpected = |value| StoreError::Unexpected { what, value, expected: "a stored layout" };
        let (id, content) =
            head(bytes).ok_or_else(|| unexpected(format!("{} bytes of {of}", bytes.len())))?;
        let layout = self.0.get(&id).ok_or_else(|| unexpected(format!("layout {id} of {of}")))?;
        Ok((layout, content))
    }

    fn decode<T: DeserializeOwned>(
        &self,
        bytes: &[u8],
        what: &'static str,
        of: &str,
    ) -> Result<T, StoreError> {
        let damaged = StoreError::damaged(what, of);
        if bytes.first() != Some(&COLUMNS) {
            return serde_json::from_slice(bytes).map_err(damaged);
        }
        let (layout, content) = self.layout(bytes, what, of)?;
        filled::read(layout, content).map_err(damaged)?.ok_or_else(|| StoreError::Unexpected {
            what,
            value: format!("{} bytes of {of}", bytes.len()),
            expected: "as many as its layout has",
        })
    }
}

impl Transaction {
    /// Stores the layouts of values that are to be written in this transaction.
    pub(in crate::store) async fn store_layouts<'a>(
        &mut self,
        columns: impl IntoIterator<Item = &'a Columns>,
    ) -> Result<(), StoreError> {
        // Sorted: in the same order in all transactions, to avoid deadlocks.
        let mut new = BTreeMap::new();
        for Columns { layout: (id, layout), .. } in columns {
            if !self.layouts.lock().contains_key(id) && !self.new_layouts.contains_key(id) {
                new.insert(*id, layout.clone());
            }
        }
        let new: Vec<(i64, String)> = new.into_iter().collect();
        for chunk in new.chunks(ROWS_PER_STATEMENT) {
            let text = format!(
                "INSERT INTO layouts (id, layout) VALUES {} ON CONFLICT (id) DO NOTHING",
                rows_of_placeholders(chunk.len(), 2)
            );
            let query = sqlx::query(&text).persistent(self.dialect.caches_statement(chunk.len()));
            let query = chunk.iter().fold(query, |query, (id, layout)| query.bind(*id).bind(layout.as_str()));
            query.execute(&mut *self.inner).await?;
        }
        for (id, layout) in new {
            self.new_layouts.insert(id, Arc::new(from_json(&layout, "layout", "a record")?));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;
    use serde_json::json;

    use super::*;

    fn read<T: DeserializeOwned>(columns: &Columns) -> Result<T, StoreError> {
        let (id, layout) = &columns.layout;
        let layouts = Layouts(HashMap::from([(*id, Arc::new(serde_json::from_str(layout).unwrap()))]));
        layouts.decode(&columns.bytes, "indicators", "a record")
    }

    #[test]
    fn a_value_is_read_as_it_was_written() {
        for value in [
            json!({}),
            json!({ "indicators": { "rms": 0.1, "kurtosis": -0.0, "peak": 5e-324 }, "absent": { "fm4": "no_speed" } }),
            json!([null, true, 3, -1, "", "é \"quoted\"", { "extent": [1.0, 2.5e300, [] ] }]),
        ] {
            assert_eq!(
                read::<Value>(&Columns::of(&value, "indicators", "a record").unwrap()).unwrap(),
                value
            );
        }
    }

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    enum Kind {
        Plain,
        Scaled(f64),
        Between { low: f64, high: f64 },
    }

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Reading {
        count: u32,
        kinds: [Kind; 3],
        name: Option<String>,
        none: Option<f64>,
        pair: (f64, String),
    }

    #[test]
    fn types_are_read_as_from_json() {
        let reading = Reading {
            count: 3,
            kinds: [Kind::Scaled(0.5), Kind::Plain, Kind::Between { low: -1.0, high: 2.0 }],
            name: Some("é".to_owned()),
            none: None,
            pair: (1e-300, String::new()),
        };
        let columns = Columns::of(&reading, "features", "a record").unwrap();
        assert_eq!(read::<Reading>(&columns).unwrap(), reading);
        let error = read::<Vec<f64>>(&columns).unwrap_err().to_string();
        assert!(error.contains("indicators"), "{error}");
        // A list with more entries than the type has.
        let columns = Columns::of(&[0.5, 0.25, 0.125], "features", "a record").unwrap();
        assert!(read::<[f64; 2]>(&columns).is_err());
    }

    #[test]
    fn values_of_the_same_names_share_a_layout() {
        let columns = |value: &Value| Columns::of(value, "features", "a record").unwrap();
        let first = columns(&json!({ "values": { "ln_rms": 1.5, "ln_mesh_1": 0.25 } }));
        let second = columns(&json!({ "values": { "ln_mesh_1": -7.0, "ln_rms": 2.0 } }));
        assert_eq!(first.layout, second.layout);
        assert_eq!(first.bytes.len(), HEAD + 2 * 8);
        let other = columns(&json!({ "values": { "ln_rms": 1.5 } }));
        assert_ne!(first.layout.0, other.layout.0);
    }

    #[test]
    fn bytes_that_do_not_fit_their_layout_are_an_error() {
        let mut columns = Columns::of(&json!({ "rms": 0.1, "unit": "g" }), "indicators", "a record").unwrap();
        for wrong in [&columns.bytes[..columns.bytes.len() - 1], &columns.bytes[..HEAD - 1], &[]] {
            let layouts = Layouts(HashMap::new());
            assert!(layouts.decode::<Value>(wrong, "indicators", "a record").is_err());
        }
        columns.bytes.push(0);
        let error = read::<Value>(&columns).unwrap_err().to_string();
        assert!(error.contains("indicators"), "{error}");
    }
}
