//! Selects and counts an asset's records by operating bin and status, or by id.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::asset::{AssetId, OperatingBin, Segment, SegmentId};
use crate::estimate::WearStatus;
use crate::http::app::App;
use crate::http::problem::Problem;
use crate::http::request::query::{self, AssetPath, Parameters};
use crate::http::request::selection::{self, Selection};
use crate::store::{Order, RecordRange, SegmentFilter, SegmentKey, Store, StoreError, Trend};

/// Maximum number of ids per request.
const MAX_NAMED: usize = 200;

/// Filters of records besides channel and time.
#[derive(Debug, Default)]
pub(crate) struct RecordChoice {
    /// Only records in this bin.
    pub(crate) bin: Option<OperatingBin>,
    /// Only records with these statuses; all if empty.
    pub(crate) statuses: Vec<WearStatus>,
}

impl RecordChoice {
    /// The matching positions in a trend.
    pub(crate) fn of(&self, trend: &Trend, from: Option<Timestamp>, to: Option<Timestamp>) -> Selection {
        let selection = Selection::of(trend, from, to, self.bin.as_ref());
        match self.statuses.is_empty() {
            true => selection,
            false => selection.only(|n| self.statuses.contains(&trend.wear[n].status)),
        }
    }

    /// Returns up to `limit` segments; filtered ones are found in the histories of the asset's channels.
    pub(crate) async fn segments(
        &self,
        store: &Store,
        asset: &AssetId,
        filter: &SegmentFilter,
        limit: u32,
    ) -> Result<Vec<Segment>, StoreError> {
        if self.bin.is_none() && self.statuses.is_empty() {
            return store.segments(asset, filter, limit).await;
        }
        let limit = limit as usize;
        let mut keys: Vec<SegmentKey> = Vec::new();
        for channel in store.channels(asset).await? {
            if filter.channel.as_ref().is_some_and(|name| *name != channel.channel) {
                continue;
            }
            let trend = store.trend(&channel).await?;
            let selection = self.of(&trend, filter.from, filter.to);
            let key = |n: usize| SegmentKey {
                start_time: trend.start_time[selection.position(n)],
                id: trend.segment_id[selection.position(n)].clone(),
            };
            let all = 0..selection.len();
            let is_after = |key: &SegmentKey| match (&filter.after, filter.order) {
                (None, _) => true,
                (Some(after), Order::Asc) => key > after,
                (Some(after), Order::Desc) => key < after,
            };
            match filter.order {
                Order::Asc => keys.extend(all.map(key).filter(is_after).take(limit)),
                Order::Desc => keys.extend(all.rev().map(key).filter(is_after).take(limit)),
            }
        }
        keys.sort_unstable();
        if filter.order == Order::Desc {
            keys.reverse();
        }
        keys.truncate(limit);
        let ids: Vec<SegmentId> = keys.into_iter().map(|key| key.id).collect();
        store.segments_by_id(&ids).await
    }
}

/// The requested statuses.
pub(crate) fn parse_statuses(requested: Option<&str>) -> Result<Vec<WearStatus>, Problem> {
    let status = |name: &str| {
        serde_json::from_value(Value::from(name)).map_err(|error| {
            // The decoder's message ends with all statuses.
            let message = error.to_string().replace('`', "");
            Problem::query("status", name, message.rsplit("expected ").next().unwrap_or_default())
        })
    };
    query::entries(requested).map(status).collect()
}

/// One range for each record of an asset named in `ids`.
pub(crate) async fn named(store: &Store, asset: &AssetId, ids: &str) -> Result<Vec<RecordRange>, Problem> {
    store.asset(asset).await?;
    let ids: Vec<SegmentId> = ids.split(',').map(|id| SegmentId(id.trim().to_owned())).collect();
    if ids.len() > MAX_NAMED {
        let expected = format!("at most {MAX_NAMED} identifiers");
        return Err(Problem::query("ids", format!("{} identifiers", ids.len()), &expected));
    }
    let mut found = store.segments_by_id(&ids).await?;
    found.retain(|segment| segment.asset_id == *asset);
    if let Some(unknown) = ids.iter().find(|id| !found.iter().any(|segment| segment.id == **id)) {
        return Err(Problem::not_found(format!("asset {asset} has no segment {unknown}")));
    }
    Ok(found.iter().map(RecordRange::of).collect())
}

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct CountParameters {
    /// Only this channel.
    channel: Option<String>,
    /// Only records that start at this time or later.
    from: Option<Timestamp>,
    /// Only records that start before this time.
    to: Option<Timestamp>,
    /// Only records in this operating bin of the asset.
    operating_bin: Option<String>,
    /// Only records whose estimate has one of these statuses, comma-separated.
    #[param(example = "estimated,excluded")]
    status: Option<String>,
}

/// A number of records.
#[derive(Debug, Default, Serialize, utoipa::ToSchema)]
pub(crate) struct RecordCount {
    /// Records.
    records: u64,
    /// Start of the earliest one.
    first_start_time: Option<Timestamp>,
    /// Start of the latest one.
    last_start_time: Option<Timestamp>,
}

/// Count the segments of an asset
#[utoipa::path(
    get,
    path = "/v1/assets/{asset}/segments/count",
    tag = "records",
    params(CountParameters),
    responses((status = 422, description = "A time out of range"), (status = 200, body = RecordCount)),
)]
pub(crate) async fn count(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<CountParameters>,
) -> Result<Json<RecordCount>, Problem> {
    let store = &app.service.store;
    let spec = store.asset(&asset).await?.spec;
    let choice = RecordChoice {
        bin: selection::requested_bin(&spec, params.operating_bin.as_deref())?,
        statuses: parse_statuses(params.status.as_deref())?,
    };
    let mut count = RecordCount::default();
    for channel in store.channels(&asset).await? {
        if params.channel.as_ref().is_some_and(|name| *name != channel.channel) {
            continue;
        }
        let trend = store.trend(&channel).await?;
        let selection = choice.of(&trend, params.from, params.to);
        let Some(last) = selection.len().checked_sub(1) else {
            continue;
        };
        let (first, last) =
            (trend.start_time[selection.position(0)], trend.start_time[selection.position(last)]);
        count.records += selection.len() as u64;
        count.first_start_time = Some(count.first_start_time.map_or(first, |earliest| earliest.min(first)));
        count.last_start_time = count.last_start_time.max(Some(last));
    }
    Ok(Json(count))
}
