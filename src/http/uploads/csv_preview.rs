//! `/v1/csv-preview`: the contents of a CSV file before the upload.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use crate::http::app::App;
use crate::http::problem::Problem;
use crate::http::request::body;
use crate::http::request::query::Parameters;
use crate::recording::{ColumnRole, CsvLayout, CsvPreview};

/// Maximum number of bytes read of a file.
const MAX_BYTES: usize = 1 << 20;

/// Maximum number of envelope intervals.
const STRETCHES: usize = 200;

/// The CSV column layout in the query of an upload or preview.
#[derive(Debug, Clone, Default, Deserialize, Serialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct CsvParameters {
    /// Sampling rate in hertz, if the file does not contain it.
    #[param(example = 12800.0)]
    sample_rate_hz: Option<f64>,
    /// Number of the time column, from 1; 0 for none. By default detected from names and values.
    #[param(example = 1, minimum = 0, maximum = 256)]
    time_column: Option<u16>,
    /// Numbers of the channel columns, from 1, comma-separated; by default all but the time column.
    #[param(example = "2,3")]
    columns: Option<String>,
}

/// A CSV file as an upload would read it.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = CsvPreview)]
pub(crate) struct CsvPreviewView {
    /// All columns of the file.
    columns: Vec<CsvColumnView>,
    /// Sampling rate in hertz; none if unknown.
    sample_rate_hz: Option<f64>,
    /// Source of the sampling rate.
    rate_source: Option<CsvRateSource>,
    /// Time of the first sample, if a column contains dates.
    start_time: Option<Timestamp>,
    /// Number of sample lines.
    lines: u64,
    /// Why the file would be rejected.
    fault: Option<String>,
}

/// A column of a CSV file.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = CsvColumn)]
struct CsvColumnView {
    /// Number of the column, from 1.
    number: usize,
    /// As in the header, with its unit.
    label: String,
    /// Name of the channel.
    name: String,
    /// Unit in the header.
    unit: Option<String>,
    /// Role of the column.
    role: CsvColumnRole,
    /// For a channel: minimum and maximum of up to 200 intervals of the lines.
    envelope: Vec<[f32; 2]>,
}

/// Role of a column.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
enum CsvColumnRole {
    /// Samples.
    Channel,
    /// The time of each line.
    Time,
    /// Ignored.
    LeftOut,
}

/// Source of a sampling rate.
#[derive(Debug, Clone, Copy, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
enum CsvRateSource {
    /// The request.
    Given,
    /// A line before the header.
    Header,
    /// The time column.
    Times,
}

/// Preview a CSV file
///
/// Inspects a CSV file or its beginning: columns, sampling rate, start and the shape of each channel, as an
/// upload with the same parameters would read them. The body is at most 1 MiB of whole lines. Nothing is
/// stored.
#[utoipa::path(
    post,
    path = "/v1/csv-preview",
    tag = "records",
    params(CsvParameters),
    request_body(content_type = "text/csv", content = String),
    responses((status = 200, body = CsvPreviewView)),
)]
pub(crate) async fn csv_preview(
    State(app): State<App>,
    Parameters(params): Parameters<CsvParameters>,
    headers: HeaderMap,
    body: Body,
) -> Result<Json<CsvPreviewView>, Problem> {
    let media_type = body::media_type(&headers);
    if media_type.as_deref() != Some("text/csv") {
        return Err(body::unsupported(media_type.as_deref(), "text/csv"));
    }
    let layout = params.layout()?;
    let _ticket = app.service.workers.admit_response()?;
    let lines = body::read(&headers, body, MAX_BYTES, &app.limits, |_| Ok(())).await?;
    let preview = move || CsvPreview::of(&lines, layout, STRETCHES);
    let preview = app.service.workers.run("preview a CSV file", preview).await??;
    Ok(Json(CsvPreviewView::of(preview, layout)))
}

impl CsvParameters {
    pub(crate) fn new(
        sample_rate_hz: Option<f64>,
        time_column: Option<u16>,
        columns: Option<String>,
    ) -> Self {
        Self { sample_rate_hz, time_column, columns }
    }

    /// The requested column layout.
    pub(crate) fn layout(&self) -> Result<CsvLayout, Problem> {
        check_rate(self.sample_rate_hz)?;
        let numbers = self.columns.iter().flat_map(|columns| columns.split(','));
        let number = |text: &str| {
            let refused = || Problem::query("columns", format!("{text:?}"), "numbers from 1 to 256");
            text.trim().parse::<u16>().map_err(|_| refused())
        };
        let columns: Vec<u16> = numbers.map(number).collect::<Result<_, _>>()?;
        Ok(CsvLayout::new(self.sample_rate_hz, self.time_column, &columns)?)
    }
}

/// Refuses a sampling rate that no recording can have.
pub(crate) fn check_rate(sample_rate_hz: Option<f64>) -> Result<(), Problem> {
    match sample_rate_hz.filter(|rate| !(*rate > 0.0 && rate.is_finite())) {
        Some(rate) => Err(Problem::query("sample_rate_hz", rate, "a rate above 0")),
        None => Ok(()),
    }
}

impl CsvPreviewView {
    fn of(preview: CsvPreview, layout: CsvLayout) -> Self {
        let (contents, fault) = match preview.contents {
            Ok(contents) => (Some(contents), None),
            Err(error) => (None, Some(error.to_string())),
        };
        let timing = contents.as_ref().map(|contents| &contents.timing);
        let mut envelopes = contents.iter().flat_map(|contents| contents.envelopes.iter().cloned());
        let columns = preview.columns.into_iter().enumerate().map(|(at, column)| {
            let (role, envelope) = match column.role {
                ColumnRole::Channel => (CsvColumnRole::Channel, envelopes.next().unwrap_or_default()),
                ColumnRole::Time => (CsvColumnRole::Time, Vec::new()),
                ColumnRole::Ignored => (CsvColumnRole::LeftOut, Vec::new()),
            };
            let (label, name, unit) = (column.label, column.name, column.unit);
            CsvColumnView { number: at + 1, label, name, unit, role, envelope }
        });
        let stated = timing.and_then(|timing| timing.stated_rate_hz).map(|_| CsvRateSource::Header);
        let clock = timing.and_then(|timing| timing.clock_rate_hz).map(|_| CsvRateSource::Times);
        Self {
            columns: columns.collect(),
            rate_source: layout.sample_rate_hz.map(|_| CsvRateSource::Given).or(stated).or(clock),
            sample_rate_hz: contents.as_ref().and_then(|contents| contents.sample_rate_hz),
            start_time: timing.and_then(|timing| timing.dated_start),
            lines: timing.map_or(0, |timing| timing.frames),
            fault,
        }
    }
}
