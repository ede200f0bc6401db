//! Rows as JSON or, for those who ask for it, as CSV.

use axum::Json;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;

use super::problem::Problem;

/// A table as it is written.
pub(super) struct Table(csv::Writer<Vec<u8>>);

impl Table {
    /// Adds a row.
    pub(super) fn row<I, T>(&mut self, fields: I) -> Result<(), csv::Error>
    where
        I: IntoIterator<Item = T>,
        T: AsRef<[u8]>,
    {
        self.0.write_record(fields)
    }
}

/// A number as it stands in a table: nothing where there is none.
pub(super) fn number(value: Option<f64>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

/// Whether the client asks for CSV before JSON.
pub(super) fn wants_csv(headers: &HeaderMap) -> bool {
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
    quality("text/csv") > quality("application/json")
}

/// The answer as it was asked for, with its mark.
pub(super) fn answer<T: Serialize>(
    mark: HeaderValue,
    wants_csv: bool,
    view: T,
    write: impl FnOnce(&T, &mut Table) -> Result<(), csv::Error>,
) -> Result<Response, Problem> {
    let fields = [(header::ETAG, mark), (header::VARY, HeaderValue::from_static("accept"))];
    if !wants_csv {
        return Ok((fields, Json(view)).into_response());
    }
    let fault = |error: String| {
        Problem::new(StatusCode::INTERNAL_SERVER_ERROR, format!("the table cannot be written: {error}"))
    };
    let mut table = Table(csv::Writer::from_writer(Vec::new()));
    write(&view, &mut table).map_err(|error| fault(error.to_string()))?;
    let bytes = table.0.into_inner().map_err(|error| fault(error.to_string()))?;
    Ok((fields, [(header::CONTENT_TYPE, "text/csv; charset=utf-8")], bytes).into_response())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn csv_goes_to_those_who_prefer_it() {
        for (accept, expected) in [
            ("", false),
            ("*/*", false),
            ("text/csv", true),
            ("text/csv;q=0.5, application/json", false),
            ("application/json;q=0.1,TEXT/CSV;q=0.9", true),
        ] {
            let mut headers = HeaderMap::new();
            headers.insert(header::ACCEPT, HeaderValue::from_static(accept));
            assert_eq!(wants_csv(&headers), expected, "{accept}");
        }
    }
}
