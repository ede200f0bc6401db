//! Rows as JSON or, on request, as a CSV or Parquet table.

mod parquet;

use axum::Json;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::Serialize;

use super::problem::Problem;

/// Media type of Parquet files.
pub(crate) const PARQUET: &str = "application/vnd.apache.parquet";

/// Header of a table without all rows, as the table itself cannot say so.
pub(crate) const REDUCED: &str = "flankwatch-reduced";

/// Headers of a table: its channel, in UTF-8, and its number of rows.
pub(crate) const CHANNEL: &str = "flankwatch-channel";
pub(crate) const ROWS: &str = "flankwatch-rows";

/// The format of rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Format {
    Json,
    Csv,
    Parquet,
}

impl Format {
    /// The client's preferred format; JSON if equally preferred.
    pub(super) fn accepted(headers: &HeaderMap) -> Self {
        let accept = headers.get(header::ACCEPT).and_then(|value| value.to_str().ok()).unwrap_or_default();
        let quality = |wanted: &str| {
            let ranges = accept.split(',').filter_map(|range| {
                let mut parts = range.split(';').map(str::trim);
                let is_wanted = parts.next()?.eq_ignore_ascii_case(wanted);
                let quality =
                    parts.find_map(|part| part.strip_prefix("q=")).map_or(1.0, |q| q.parse().unwrap_or(0.0));
                is_wanted.then_some(quality)
            });
            ranges.fold(0.0_f64, f64::max)
        };
        let mut best = (Self::Json, quality("application/json"));
        for (format, media_type) in [(Self::Csv, "text/csv"), (Self::Parquet, PARQUET)] {
            let quality = quality(media_type);
            if quality > best.1 {
                best = (format, quality);
            }
        }
        best.0
    }
}

/// Columns of the same length.
#[derive(Debug)]
pub(super) struct Table {
    columns: Vec<Column>,
    /// The channel of the rows.
    channel: Option<String>,
    /// Whether rows were dropped.
    is_reduced: bool,
}

#[derive(Debug)]
struct Column {
    name: String,
    unit: Option<String>,
    values: Values,
}

#[derive(Debug)]
enum Values {
    Times(Vec<Timestamp>),
    Words(Vec<String>),
    /// NaN for missing values.
    Numbers(Vec<f64>),
}

impl Table {
    pub(super) fn new(channel: Option<&String>, is_reduced: bool) -> Self {
        Self { columns: Vec::new(), channel: channel.cloned(), is_reduced }
    }

    pub(super) fn times(&mut self, name: &str, values: impl Iterator<Item = Timestamp>) {
        self.add(name, None, Values::Times(values.collect()));
    }

    pub(super) fn words(&mut self, name: &str, values: impl Iterator<Item = String>) {
        self.add(name, None, Values::Words(values.collect()));
    }

    pub(super) fn numbers(&mut self, name: &str, unit: &str, values: impl Iterator<Item = Option<f64>>) {
        let values = values.map(|value| value.unwrap_or(f64::NAN)).collect();
        self.add(name, Some(unit.to_owned()), Values::Numbers(values));
    }

    fn add(&mut self, name: &str, unit: Option<String>, values: Values) {
        self.columns.push(Column { name: name.to_owned(), unit, values });
    }

    fn rows(&self) -> usize {
        self.columns.first().map_or(0, |column| match &column.values {
            Values::Times(times) => times.len(),
            Values::Words(words) => words.len(),
            Values::Numbers(numbers) => numbers.len(),
        })
    }

    fn csv(&self) -> Result<Vec<u8>, csv::Error> {
        let mut writer = csv::Writer::from_writer(Vec::new());
        writer.write_record(self.columns.iter().map(|column| &column.name))?;
        for row in 0..self.rows() {
            let field = |column: &Column| match &column.values {
                Values::Times(times) => times[row].to_string(),
                Values::Words(words) => words[row].clone(),
                Values::Numbers(numbers) if numbers[row].is_nan() => String::new(),
                Values::Numbers(numbers) => numbers[row].to_string(),
            };
            writer.write_record(self.columns.iter().map(field))?;
        }
        writer.into_inner().map_err(|error| error.into_error().into())
    }
}

/// Responds in the requested format, with an entity tag.
pub(super) fn respond<T: Serialize>(
    etag: HeaderValue,
    format: Format,
    view: T,
    table_of: impl FnOnce(&T) -> Table,
) -> Result<Response, Problem> {
    let fields = [(header::ETAG, etag), (header::VARY, HeaderValue::from_static("accept"))];
    let fault = |error: String| {
        Problem::new(StatusCode::INTERNAL_SERVER_ERROR, format!("failed to write the table: {error}"))
    };
    if format == Format::Json {
        return Ok((fields, Json(view)).into_response());
    }
    let table = table_of(&view);
    let (media_type, bytes) = match format {
        Format::Parquet => (PARQUET, parquet::file(&table).map_err(|error| fault(error.to_string()))?),
        _ => ("text/csv; charset=utf-8", table.csv().map_err(|error| fault(error.to_string()))?),
    };
    let reduced = table.is_reduced.then_some([(REDUCED, "true")]);
    let channel = table.channel.as_ref().and_then(|name| HeaderValue::from_bytes(name.as_bytes()).ok());
    let channel = channel.map(|name| [(CHANNEL, name)]);
    let own = [(header::CONTENT_TYPE.as_str(), media_type.to_owned()), (ROWS, table.rows().to_string())];
    Ok((fields, reduced, channel, own, bytes).into_response())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_preferred_format_is_selected() {
        for (accept, expected) in [
            ("", Format::Json),
            ("*/*", Format::Json),
            ("text/csv", Format::Csv),
            ("text/csv;q=0.5, application/json", Format::Json),
            ("application/json;q=0.1,TEXT/CSV;q=0.9", Format::Csv),
            (PARQUET, Format::Parquet),
            ("text/csv;q=0.5, application/vnd.apache.parquet", Format::Parquet),
        ] {
            let mut headers = HeaderMap::new();
            headers.insert(header::ACCEPT, HeaderValue::from_static(accept));
            assert_eq!(Format::accepted(&headers), expected, "{accept}");
        }
    }
}
