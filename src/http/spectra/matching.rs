//! `/v1/segments/{segment}/match`: feature changes of a record since the baseline, with the library's
//! prediction.

use axum::Json;
use axum::extract::State;
use serde::Serialize;

use super::waterfall::evenly;
use crate::asset::{Segment, SegmentId};
use crate::http::app::App;
use crate::http::baseline::BaselinePeriod;
use crate::http::problem::Problem;
use crate::http::request::query::SegmentPath;
use crate::http::{assets, libraries, segments};
use crate::library::Library;
use crate::signal::Name;

/// Decibels in one unit of a natural logarithm of an amplitude.
const DB_PER_NEPER: f64 = 20.0 / std::f64::consts::LN_10;

/// Minimum ratio of a line's healthy amplitude to the noise beside it for the line to count.
const MIN_LINE_TO_BACKGROUND: f64 = 2.0;

/// Maximum number of baseline records that are read.
const MAX_BASELINE: usize = 1000;

/// Measured and expected changes since the baseline.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct MatchView {
    /// The record.
    segment_id: SegmentId,
    /// The library.
    library_id: String,
    /// The state that explains the record best.
    state_index: usize,
    /// Wear depth in µm, the maximum over the flank.
    wear_um: f64,
    /// The 90 % interval of the wear depth in µm.
    interval_um: [f64; 2],
    /// Number of baseline records compared, at most 1000 of them.
    baseline_records: usize,
    /// The features by name.
    features: Vec<FeatureRow>,
}

/// One feature's change since the baseline, in dB of its amplitude.
#[derive(Debug, Serialize, utoipa::ToSchema)]
struct FeatureRow {
    /// The feature's name.
    name: String,
    /// Its change since the baseline in dB of amplitude.
    measured_db: f64,
    /// Standard deviation over the baseline's records.
    scatter_db: f64,
    /// The library's change at the median wear depth.
    expected_db: Option<f64>,
    /// The minimum and maximum change within the interval of wear depths.
    expected_interval_db: Option<[f64; 2]>,
    /// Whether the feature was above the noise when healthy.
    above_noise: bool,
}

/// Measured and expected changes since the baseline
#[utoipa::path(
    get,
    path = "/v1/segments/{segment}/match",
    tag = "records",
    responses((status = 200, body = MatchView)),
)]
pub(crate) async fn show(
    State(app): State<App>,
    SegmentPath(id): SegmentPath,
) -> Result<Json<MatchView>, Problem> {
    let segment = segments::find(&app, &id).await?;
    let wear = &segment.wear;
    let (Some(library_id), Some(state), Some(median), Some(low), Some(high)) =
        (&wear.library_id, &wear.best_state, wear.median_um, wear.low_um, wear.high_um)
    else {
        return Err(Problem::not_found(format!("this record cannot be matched: {}", wear.reason)));
    };
    let library = libraries::find(&app, library_id).await?;
    let baseline = complete_baseline(&app, &segment).await?;
    Ok(Json(MatchView {
        library_id: library_id.clone(),
        state_index: state.index,
        wear_um: median,
        interval_um: [low, high],
        baseline_records: baseline.len(),
        features: rows(&segment, &baseline, &library, [low, median, high]),
        segment_id: segment.id,
    }))
}

/// The records of the baseline that a record is compared with, at most 1000 of them, evenly spaced; none
/// while it is being collected.
pub(crate) async fn complete_baseline(app: &App, segment: &Segment) -> Result<Vec<Segment>, Problem> {
    let store = &app.service.store;
    let channels = store.channels(&segment.asset_id).await?;
    let trend = store.trend(assets::channel_named(&segment.asset_id, &channels, &segment.channel)?).await?;
    let period = BaselinePeriod::at(store, &segment.asset_id, Some(segment.start_time)).await?;
    let positions = period.positions(&trend);
    if !period.is_complete(&trend, &positions, segment.wear.baseline.need) {
        return Ok(Vec::new());
    }
    let chosen = evenly(positions.len(), MAX_BASELINE).into_iter();
    let ids: Vec<SegmentId> = chosen.map(|n| trend.segment_id[positions[n]].clone()).collect();
    Ok(store.segments_by_id(&ids).await?)
}

fn rows(segment: &Segment, baseline: &[Segment], library: &Library, wear_um: [f64; 3]) -> Vec<FeatureRow> {
    let curves = library.feature_curves();
    let depths: Vec<f64> = library.states().iter().map(|state| state.wear_um).collect();
    let measured = segment.features.values.iter();
    let row = |(name, value): (&Name, &f64)| {
        let healthy: Option<Vec<f64>> =
            baseline.iter().map(|record| record.features.values.get(name).copied()).collect();
        let healthy = healthy.filter(|values| !values.is_empty())?;
        let (mean, deviation) = moments(&healthy);
        let noise: Vec<f64> =
            baseline.iter().filter_map(|record| record.features.background.get(name).copied()).collect();
        let curve = curves.get(name.as_str());
        let change = |um: f64| curve.map(|curve| DB_PER_NEPER * (interpolate(&depths, curve, um) - curve[0]));
        Some(FeatureRow {
            name: name.to_string(),
            measured_db: DB_PER_NEPER * (value - mean),
            scatter_db: DB_PER_NEPER * deviation,
            expected_db: change(wear_um[1]),
            expected_interval_db: change(wear_um[0]).zip(change(wear_um[2])).map(|(first, last)| {
                let within = depths.iter().filter(|um| (wear_um[0]..=wear_um[2]).contains(*um));
                within
                    .filter_map(|um| change(*um))
                    .fold([first.min(last), first.max(last)], |[low, high], db| [low.min(db), high.max(db)])
            }),
            above_noise: noise.is_empty() || mean >= moments(&noise).0 + MIN_LINE_TO_BACKGROUND.ln(),
        })
    };
    measured.filter_map(row).collect()
}

/// Mean and standard deviation.
fn moments(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (mean, (squares / values.len().saturating_sub(1).max(1) as f64).sqrt())
}

/// Linear interpolation between ascending nodes, constant beyond the ends.
fn interpolate(nodes: &[f64], values: &[f64], x: f64) -> f64 {
    let upper = nodes.partition_point(|node| *node <= x).clamp(1, nodes.len().max(2) - 1);
    let part = (x - nodes[upper - 1]) / (nodes[upper] - nodes[upper - 1]);
    values[upper - 1] + part.clamp(0.0, 1.0) * (values[upper] - values[upper - 1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interpolation_is_linear_between_states_and_constant_beyond() {
        let at = |x| interpolate(&[0.0, 5.0, 10.0], &[1.0, 2.0, 0.0], x);
        assert_eq!([-1.0, 0.0, 2.5, 5.0, 7.5, 10.0, 99.0].map(at), [1.0, 1.0, 1.5, 2.0, 1.0, 0.0, 0.0]);
    }

    #[test]
    fn moments_of_one_and_three() {
        // Sample variance by hand: ((1 − 2)² + (3 − 2)²)/1 = 2.
        assert_eq!(moments(&[1.0, 3.0]), (2.0, 2f64.sqrt()));
    }
}
