//! `/v1/assets/{asset}/indicators/baseline`: statistics of indicators in the records of the healthy baseline.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use crate::http::app::App;
use crate::http::baseline::BaselinePeriod;
use crate::http::problem::Problem;
use crate::http::request::query::{AssetPath, Parameters};
use crate::http::{assets, indicators};
use crate::signal::Indicators;

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct BaselineParameters {
    /// Indicator names, comma-separated, 1 to 64.
    #[param(example = "rms,kurtosis")]
    names: String,
    /// The channel; by default the one that represents the asset.
    channel: Option<String>,
}

/// Statistics of indicators in the baseline of a channel.
#[derive(Debug, Default, Serialize, utoipa::ToSchema)]
pub(crate) struct BaselineView {
    /// The channel; none if the asset has no records.
    channel: Option<String>,
    /// Number of records of the latest baseline; statistics need at least 2.
    records: u64,
    /// Start of its first record.
    first_start_time: Option<Timestamp>,
    /// Start of its last record.
    last_start_time: Option<Timestamp>,
    /// The statistics of each requested name, in order.
    items: Vec<BaselineItem>,
}

/// Statistics of one indicator.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct BaselineItem {
    /// The indicator.
    name: String,
    /// Its unit; `1` if dimensionless.
    unit: String,
    /// Number of records with a value.
    records: u64,
    /// Mean of the values.
    mean: Option<f64>,
    /// Sample standard deviation of the values (n − 1).
    standard_deviation: Option<f64>,
}

/// Indicators over the baseline
///
/// Mean and standard deviation over the records of a channel's latest baseline, without excluded records.
#[utoipa::path(
    get,
    path = "/v1/assets/{asset}/indicators/baseline",
    tag = "trends",
    params(BaselineParameters),
    responses((status = 200, body = BaselineView)),
)]
pub(crate) async fn show(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<BaselineParameters>,
) -> Result<Json<BaselineView>, Problem> {
    let names: Vec<String> = params.names.split(',').map(|name| name.trim().to_owned()).collect();
    if names.len() > 64 {
        return Err(Problem::query("names", format!("{} names", names.len()), "at most 64 names"));
    }
    let (asset, channel) = assets::asset_and_channel(&app, &asset, params.channel.as_deref()).await?;
    let store = &app.service.store;
    let trend = match &channel {
        Some(channel) => Some(store.trend(channel).await?),
        None => None,
    };
    let none = Default::default();
    indicators::check_names(&names, trend.as_ref().map_or(&none, |trend| &trend.indicators), &asset.spec)?;
    let (Some(channel), Some(trend)) = (channel, trend) else {
        return Ok(Json(BaselineView::default()));
    };
    let positions = BaselinePeriod::at(store, &asset.spec.id, None).await?.positions(&trend);
    let item = |name: &String| {
        let column = trend.indicators.get(name);
        let values = positions.iter().filter_map(|n| column.map(|column| column[*n]));
        let (records, mean, standard_deviation) = scatter(values.filter(|value| value.is_finite()));
        BaselineItem {
            name: name.clone(),
            unit: Indicators::unit(name, &trend.unit, &asset.spec.bands),
            records,
            mean,
            standard_deviation,
        }
    };
    let time = |n: Option<&usize>| n.map(|n| trend.start_time[*n]);
    Ok(Json(BaselineView {
        channel: Some(channel.channel),
        records: positions.len() as u64,
        first_start_time: time(positions.first()),
        last_start_time: time(positions.last()),
        items: names.iter().map(item).collect(),
    }))
}

/// Number, mean and standard deviation of values.
fn scatter(values: impl Iterator<Item = f64> + Clone) -> (u64, Option<f64>, Option<f64>) {
    let count = values.clone().count();
    let mean = values.clone().sum::<f64>() / count as f64;
    let squares: f64 = values.map(|value| (value - mean).powi(2)).sum();
    let deviation = (squares / count.saturating_sub(1) as f64).sqrt();
    (
        count as u64,
        (count > 0).then_some(mean).filter(|mean| mean.is_finite()),
        (count > 1).then_some(deviation).filter(|deviation| deviation.is_finite()),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scatter_is_that_of_a_sample() {
        assert_eq!(scatter([2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0].into_iter()).1, Some(5.0));
        let deviation = scatter([1.0, 3.0].into_iter()).2.unwrap();
        assert!((deviation - std::f64::consts::SQRT_2).abs() < 1e-12);
        assert_eq!(scatter([1.5].into_iter()), (1, Some(1.5), None));
        assert_eq!(scatter(std::iter::empty()), (0, None, None));
    }
}
