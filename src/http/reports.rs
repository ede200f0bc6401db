//! `GET /v1/assets/{asset}/report`: the asset's report as a printable page.

use axum::extract::{FromRequestParts, State};
use axum::http::request::Parts;
use axum::response::Html;
use serde::Deserialize;

use super::app::App;
use super::assets;
use super::problem::Problem;
use super::request::query::{AssetPath, Parameters};
use super::spectra::waterfall::evenly;
use crate::asset::{AssetId, AssetSpec, Segment, SegmentId};
use crate::report::{
    Contents, Cover, Form, INDICATORS, Report, ReportedAlarm, ReportedRecord, reading_words,
};
use crate::store::AlarmFilter;

/// Maximum number of records drawn; of longer histories an even selection.
const MAX_RECORDS: usize = 600;

/// Number of latest records that are always included.
const LATEST_RECORDS: usize = 100;

/// Maximum number of alarms of a channel, and of history entries of each.
const MAX_ALARMS: u32 = 64;
const LATEST_ENTRIES: u32 = 200;

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct ReportParameters {
    /// The channel; by default the one that represents the asset.
    channel: Option<String>,
    /// Recipient of the report.
    prepared_for: Option<String>,
    /// Author; adds a signature line at the end.
    prepared_by: Option<String>,
    /// Recommended actions; empty lines separate paragraphs.
    recommendation: Option<String>,
    /// Whether wear over time is drawn; default true.
    wear: Option<bool>,
    /// Names of the indicators drawn over time, comma-separated: `rms`, `velocity_rms`, `kurtosis`, `omx`,
    /// `omx_tracked`, `fm0`, `fm4`, `na4`; all by default, none if empty. May be repeated.
    #[param(example = "rms,omx")]
    indicators: Option<String>,
    /// Whether the spectrum of the last record is drawn; default true.
    spectrum: Option<bool>,
    /// Whether alarms and maintenance are listed; default true.
    events: Option<bool>,
    /// Whether the latest records are listed; default true.
    records: Option<bool>,
}

/// Maximum length of a text in a report, in characters.
const MAX_TEXT: usize = 4000;

impl ReportParameters {
    fn cover(&self) -> Result<Cover, Problem> {
        let text = |name: &str, text: &Option<String>| {
            let text = text.as_deref().unwrap_or_default().replace("\r\n", "\n");
            match text.chars().count() {
                0..=MAX_TEXT => Ok(text.trim().to_owned()),
                count => {
                    Err(Problem::query(name, format!("{count} characters long"), "at most 4000 characters"))
                }
            }
        };
        Ok(Cover {
            prepared_for: text("prepared_for", &self.prepared_for)?,
            prepared_by: text("prepared_by", &self.prepared_by)?,
            recommendation: text("recommendation", &self.recommendation)?,
        })
    }

    fn contents(&self) -> Result<Contents, Problem> {
        let all = Contents::default();
        let indicators = match &self.indicators {
            None => all.indicators,
            Some(names) => names
                .split(',')
                .map(str::trim)
                .filter(|name| !name.is_empty())
                .map(|name| {
                    let known = INDICATORS.iter().find(|(known, ..)| *known == name);
                    known.map(|(known, ..)| *known).ok_or_else(|| {
                        let expected = INDICATORS.map(|(known, ..)| known).join(", ");
                        Problem::query("indicators", name, &format!("some of {expected}"))
                    })
                })
                .collect::<Result<_, _>>()?,
        };
        Ok(Contents {
            wear: self.wear.unwrap_or(all.wear),
            indicators,
            spectrum: self.spectrum.unwrap_or(all.spectrum),
            events: self.events.unwrap_or(all.events),
            records: self.records.unwrap_or(all.records),
        })
    }
}

/// The parameters; a form repeats `indicators` for each chosen one.
pub(super) struct ReportQuery(ReportParameters);

impl<S: Send + Sync> FromRequestParts<S> for ReportQuery {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let joined = format!("{}?{}", parts.uri.path(), joined(parts.uri.query().unwrap_or_default()));
        if let Ok(uri) = joined.parse() {
            parts.uri = uri;
        }
        Parameters::from_request_parts(parts, state).await.map(|Parameters(params)| Self(params))
    }
}

/// A query with its values of `indicators` joined by commas.
fn joined(query: &str) -> String {
    let (chosen, mut others): (Vec<&str>, Vec<&str>) =
        query.split('&').filter(|pair| !pair.is_empty()).partition(|pair| pair.starts_with(CHOICE));
    let names: Vec<&str> = chosen.iter().filter_map(|pair| pair.strip_prefix(CHOICE)).collect();
    let indicators = format!("{CHOICE}{}", names.join(","));
    if !names.is_empty() {
        others.push(&indicators);
    }
    others.join("&")
}

const CHOICE: &str = "indicators=";

/// Report of an asset as a printable page
#[utoipa::path(
    get,
    path = "/v1/assets/{asset}/report",
    tag = "assets",
    params(ReportParameters),
    responses((status = 200, body = String, content_type = "text/html")),
)]
pub(super) async fn show(
    State(app): State<App>,
    AssetPath(id): AssetPath,
    ReportQuery(params): ReportQuery,
) -> Result<Html<String>, Problem> {
    let (asset, channel) = assets::asset_and_channel(&app, &id, params.channel.as_deref()).await?;
    let mut report = Report {
        asset: Some(asset.spec.name_or_id().to_string()),
        facts: facts(&asset.spec),
        limits: asset.spec.limits,
        cover: params.cover()?,
        contents: params.contents()?,
        form: Some(Form { channel: params.channel.clone() }),
        ..Report::default()
    };
    report.maintenance = app.service.store.maintenance(&id).await?;
    if let Some(channel) = channel {
        report.alarms = alarms(&app, &id, &channel.channel).await?;
        let trend = app.service.store.trend(&channel).await?;
        let all = trend.segment_id.len();
        let early = all.saturating_sub(LATEST_RECORDS);
        let mut positions = evenly(early, MAX_RECORDS - LATEST_RECORDS);
        positions.extend(early..all);
        let ids: Vec<SegmentId> = positions.iter().map(|n| trend.segment_id[*n].clone()).collect();
        let segments = app.service.store.segments_by_id(&ids).await?;
        if let Some(last) = segments.last() {
            let _ticket = app.service.workers.admit_response()?;
            report.last_spectrum = match app.service.records.spectrum(last).await {
                Err(error) if error.is_raw_unavailable() => None,
                spectrum => Some(spectrum?.0),
            };
        }
        report.all_records = Some(all);
        report.records = segments.into_iter().map(ReportedRecord::from).collect();
    }
    let html = app.service.workers.run("write a report", move || report.html()).await?;
    Ok(Html(html))
}

/// The alarms of a channel with their histories.
async fn alarms(app: &App, asset: &AssetId, channel: &str) -> Result<Vec<ReportedAlarm>, Problem> {
    let (store, now) = (&app.service.store, app.service.now());
    let filter = AlarmFilter {
        asset: Some(asset.clone()),
        channel: Some(channel.to_owned()),
        ..AlarmFilter::default()
    };
    let mut reported = Vec::new();
    for stored in store.alarms(&filter, now, MAX_ALARMS).await? {
        let (history, _) = store.alarm_history(&stored.id, LATEST_ENTRIES).await?;
        reported.push(ReportedAlarm {
            channel: stored.channel,
            quantity: stored.quantity,
            rule: stored.rule,
            state: stored.alarm.state(now),
            severity: stored.alarm.severity(),
            // Withdrawn entries are omitted on paper
            history: history
                .into_iter()
                .filter(|entry| entry.withdrawn_at.is_none())
                .map(|entry| entry.change)
                .collect(),
        });
    }
    Ok(reported)
}

fn facts(spec: &AssetSpec) -> Vec<(String, String)> {
    let mut facts = Vec::new();
    if let Some([driving, driven]) = spec.teeth() {
        facts.push(("Gears".to_owned(), format!("{driving} / {driven} teeth")));
    }
    if let Some(speed_hz) = spec.nominal_speed_hz() {
        let of = if spec.gear.is_some() { "the driving shaft" } else { "the shaft" };
        facts.push((format!("Nominal speed of {of}"), format!("{} Hz", reading_words(speed_hz))));
    }
    if let Some(pair) = spec.pair() {
        let words = match pair.name.is_empty() {
            false => pair.name.clone(),
            true => {
                let geometry = &pair.geometry;
                let [module, width] = [geometry.module_mm, geometry.face_width_mm].map(reading_words);
                format!("module {module} mm, face width {width} mm")
            }
        };
        facts.push(("Gear pair".to_owned(), words));
    }
    if !spec.bearings.is_empty() {
        let names: Vec<&str> = spec.bearings.iter().map(|bearing| bearing.name.as_str()).collect();
        facts.push(("Bearings".to_owned(), names.join(", ")));
    }
    if let Some(zones) = spec.velocity_zones {
        let limits = zones.limits_mm_per_s().map(|limit| limit.to_string());
        facts.push(("Velocity zones A to D".to_owned(), format!("limits {} mm/s", limits.join(", "))));
    }
    facts
}

impl From<Segment> for ReportedRecord {
    fn from(segment: Segment) -> Self {
        Self {
            name: segment.id.to_string(),
            channel: segment.channel,
            start_time: segment.start_time,
            unit: segment.unit,
            shaft_speed_hz: segment.shaft_speed.map(|speed| speed.shaft_speed_hz),
            indicators: segment.indicators,
            shaft_angle: segment.basis.shaft_angle,
            wear_words: segment.wear.reason.clone(),
            wear: Some(segment.wear),
            reference_wear_um: segment.reference_wear_um,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::joined;

    #[test]
    fn the_boxes_of_a_form_are_one_list() {
        assert_eq!(
            joined("wear=true&indicators=&indicators=rms&events=true&indicators=fm4"),
            "wear=true&events=true&indicators=,rms,fm4"
        );
        assert_eq!(joined("indicators=rms%2Comx"), "indicators=rms%2Comx");
        assert_eq!(joined("wear=true"), "wear=true");
    }
}
