//! Reading segments.

use std::collections::{HashMap, HashSet};

use jiff::Timestamp;
use sqlx::any::AnyRow;

use crate::asset::{AssetId, RawReference, Segment, SegmentId};
use crate::estimate::WearEstimate;
use crate::signal::{Basis, Features, Indicators, OperatingPoint, ShaftSpeed};
use crate::store::database::rows::{
    asset_id, from_json, get, get_count, get_json, get_json_or_default, get_time, placeholders, to_ns,
};
use crate::store::layouts::Layouts;
use crate::store::{AnalysisGeneration, AnalysisKeys, ChannelSummary, Store, StoreError};

/// Sort key of a segment in its channel: its time, then its identifier.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SegmentKey {
    /// The time of the first sample.
    pub start_time: Timestamp,
    /// The segment.
    pub id: SegmentId,
}

impl SegmentKey {
    /// The time in nanoseconds and the identifier of a key; of a position at `start_ns` without a key.
    pub(in crate::store) fn bound(key: Option<&Self>, start_ns: i64) -> Result<(i64, &str), StoreError> {
        key.map_or(Ok((start_ns, "")), |key| Ok((to_ns(key.start_time)?, key.id.0.as_str())))
    }
}

/// A segment before its wear estimate: the results of its record alone.
#[derive(Debug, Clone, PartialEq)]
pub struct NewSegment {
    /// Identifier.
    pub id: SegmentId,
    /// The asset it belongs to.
    pub asset_id: AssetId,
    /// The measuring channel.
    pub channel: String,
    /// The time of the first sample.
    pub start_time: Timestamp,
    /// When the service received it.
    pub received_at: Timestamp,
    /// Sampling rate in hertz.
    pub sample_rate_hz: f64,
    /// Number of samples.
    pub samples: u64,
    /// Unit of the samples.
    pub unit: String,
    /// Operating point as given with the record.
    pub operating_point: OperatingPoint,
    /// Reference wear depth in µm from another source.
    pub reference_wear_um: Option<f64>,
    /// The raw bytes.
    pub raw: RawReference,
    /// Whether it is excluded from its history.
    pub excluded: bool,
    /// The analysis of its record.
    pub analysed: Analysed,
}

/// The analysis of one record.
#[derive(Debug, Clone, PartialEq)]
pub struct Analysed {
    /// The keys under which it was computed.
    pub keys: AnalysisKeys,
    /// Shaft speed that was used.
    pub shaft_speed: Option<ShaftSpeed>,
    /// The basis of indicators and features.
    pub basis: Basis,
    /// Condition indicators of the record alone.
    pub indicators: Indicators,
    /// Features for the wear estimate.
    pub features: Features,
}

/// The results of a record that depend on the earlier records.
#[derive(Debug, Clone, PartialEq)]
pub struct RunResult {
    /// Indicators that depend on the earlier records.
    pub indicators: Indicators,
    /// The wear estimate.
    pub wear: WearEstimate,
}

/// The input of the fold for a stored segment.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredFeatures {
    /// Sort key of the segment in its channel.
    pub key: SegmentKey,
    /// Whether it is excluded from its history.
    pub excluded: bool,
    /// The key under which they were computed.
    pub feature_key: String,
    /// Features for the wear estimate.
    pub features: Features,
    /// Indicators of the record alone.
    pub indicators: Indicators,
}

impl NewSegment {
    /// Place of the segment in its channel.
    pub fn key(&self) -> SegmentKey {
        SegmentKey { start_time: self.start_time, id: self.id.clone() }
    }

    /// Completes the segment with the results that depend on the earlier records.
    pub fn with_run(mut self, run: RunResult) -> Segment {
        self.analysed.indicators.extend(run.indicators);
        Segment {
            id: self.id,
            asset_id: self.asset_id,
            channel: self.channel,
            start_time: self.start_time,
            received_at: self.received_at,
            sample_rate_hz: self.sample_rate_hz,
            samples: self.samples,
            unit: self.unit,
            operating_point: self.operating_point,
            shaft_speed: self.analysed.shaft_speed,
            reference_wear_um: self.reference_wear_um,
            raw: self.raw,
            excluded: self.excluded,
            basis: self.analysed.basis,
            indicators: self.analysed.indicators,
            features: self.analysed.features,
            wear: run.wear,
        }
    }
}

/// The order in which segments are listed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Order {
    /// The earliest first.
    #[default]
    Asc,
    /// The latest first.
    Desc,
}

/// Selects the segments to be listed.
#[derive(Debug, Clone, Default)]
pub struct SegmentFilter {
    /// Only this channel.
    pub channel: Option<String>,
    /// Only those that start at this time or later.
    pub from: Option<Timestamp>,
    /// Only those that start before this time.
    pub to: Option<Timestamp>,
    /// Only those after this one in the order.
    pub after: Option<SegmentKey>,
    /// Only those that are not excluded.
    pub counted: bool,
    /// The order.
    pub order: Order,
}

/// The columns that are read of a segment.
const SEGMENT: &str =
    "SELECT s.*, c.asset_id, c.name AS channel, a.analysis_key, a.feature_key, a.shaft_speed, a.basis, a.indicator_values, a.feature_values,
        w.estimate, w.run_indicator_values, p.posterior";

/// Those of them with a layout.
const COLUMNS: [&str; 4] = ["indicator_values", "feature_values", "run_indicator_values", "posterior"];

/// Joins segments `s` with the results in their served generations.
const SERVED: &str = "JOIN channels c ON c.channel_no = s.channel_no
    JOIN analyses a ON a.segment_id = s.id AND a.generation = c.analysis_generation
    JOIN wear_estimates w ON w.segment_id = s.id AND w.generation = c.wear_generation
    LEFT JOIN wear_posteriors p ON p.segment_id = s.id AND p.generation = c.wear_generation";

impl Store {
    /// Reads a whole segment; returns `None` if there is none with that identifier.
    pub async fn segment(&self, id: &SegmentId) -> Result<Option<Segment>, StoreError> {
        Ok(self.segments_by_id(std::slice::from_ref(id)).await?.pop())
    }

    /// The unit of the latest record of each channel of an asset.
    pub async fn channel_units(&self, asset: &AssetId) -> Result<Vec<(String, String)>, StoreError> {
        let rows = sqlx::query("SELECT c.name, s.unit FROM channels c JOIN segments s ON s.id = c.last_segment_id WHERE c.asset_id = $1")
            .bind(asset.as_str())
            .fetch_all(self.read())
            .await?;
        rows.iter().map(|row| Ok((get(row, "name")?, get(row, "unit")?))).collect()
    }

    /// The unit of the latest record of a channel; `None` before its first record.
    pub async fn latest_unit(&self, channel: &ChannelSummary) -> Result<Option<String>, StoreError> {
        let Some(last) = &channel.last_segment else { return Ok(None) };
        let row = sqlx::query("SELECT unit FROM segments WHERE id = $1")
            .bind(last.0.as_str())
            .fetch_optional(self.read())
            .await?;
        row.map(|row| get(&row, "unit")).transpose()
    }

    /// Returns the identifiers of segments that exist.
    pub async fn known_segments(&self, ids: &[SegmentId]) -> Result<HashSet<SegmentId>, StoreError> {
        let mut known = HashSet::new();
        for chunk in ids.chunks(200) {
            let text = format!("SELECT id FROM segments WHERE id IN ({})", placeholders(1, chunk.len()));
            let query = chunk.iter().fold(sqlx::query(&text), |query, id| query.bind(id.0.as_str()));
            for row in query.fetch_all(self.read()).await? {
                known.insert(SegmentId(get(&row, "id")?));
            }
        }
        Ok(known)
    }

    /// Reads the segments that exist, in the order of `ids`.
    pub async fn segments_by_id(&self, ids: &[SegmentId]) -> Result<Vec<Segment>, StoreError> {
        let mut found = Vec::new();
        for chunk in ids.chunks(200) {
            let text = format!(
                "{SEGMENT} FROM segments s {SERVED} WHERE s.id IN ({})",
                placeholders(1, chunk.len())
            );
            let query = chunk.iter().fold(sqlx::query(&text), |query, id| query.bind(id.0.as_str()));
            let rows = query.fetch_all(self.read()).await?;
            let layouts = self.layouts().load(&rows, &COLUMNS, self.read()).await?;
            let mut by_id = HashMap::with_capacity(rows.len());
            for row in &rows {
                let segment = segment_of(row, &layouts)?;
                by_id.insert(segment.id.clone(), segment);
            }
            found.extend(chunk.iter().filter_map(|id| by_id.remove(id)));
        }
        Ok(found)
    }

    /// Up to `limit` segments of an asset in the order of time, with posteriors.
    pub async fn segments(
        &self,
        asset: &AssetId,
        filter: &SegmentFilter,
        limit: u32,
    ) -> Result<Vec<Segment>, StoreError> {
        let mut found = Vec::new();
        for channel in self.channels(asset).await? {
            if filter.channel.as_ref().is_none_or(|name| *name == channel.channel) {
                found.extend(self.segments_of_channel(&channel, filter, limit).await?);
            }
        }
        let key = |segment: &Segment| SegmentKey { start_time: segment.start_time, id: segment.id.clone() };
        match filter.order {
            Order::Asc => found.sort_by_key(key),
            Order::Desc => found.sort_by_key(|segment| std::cmp::Reverse(key(segment))),
        }
        found.truncate(limit as usize);
        Ok(found)
    }

    /// Up to `limit` segments of a channel after `after` with their features in a generation, in the order of
    /// time.
    pub async fn features(
        &self,
        channel: &ChannelSummary,
        generation: AnalysisGeneration,
        after: Option<&SegmentKey>,
        limit: u32,
    ) -> Result<Vec<StoredFeatures>, StoreError> {
        let (after_ns, after_id) = SegmentKey::bound(after, i64::MIN)?;
        let rows = sqlx::query(
            "SELECT s.id, s.start_time_ns, s.excluded, a.feature_key, a.feature_values, a.indicator_values
             FROM segments s JOIN analyses a ON a.segment_id = s.id AND a.generation = $1
             WHERE s.channel_no = $2 AND (s.start_time_ns, s.id) > ($3, $4)
             ORDER BY s.start_time_ns, s.id LIMIT $5",
        )
        .bind(generation.0)
        .bind(channel.channel_no)
        .bind(after_ns)
        .bind(after_id)
        .bind(i64::from(limit))
        .fetch_all(self.read())
        .await?;
        let layouts =
            self.layouts().load(&rows, &["indicator_values", "feature_values"], self.read()).await?;
        rows.iter().map(|row| features_of(row, &layouts)).collect()
    }

    async fn segments_of_channel(
        &self,
        channel: &ChannelSummary,
        filter: &SegmentFilter,
        limit: u32,
    ) -> Result<Vec<Segment>, StoreError> {
        let (after, direction, start) = match filter.order {
            Order::Asc => (">", "ASC", i64::MIN),
            Order::Desc => ("<", "DESC", i64::MAX),
        };
        let counted = if filter.counted { "AND excluded = 0" } else { "" };
        // Selected before the joins: PostgreSQL would otherwise join the whole channel, because it cannot
        // know that each segment has served results.
        let text = format!(
            "{SEGMENT} FROM (
                SELECT * FROM segments WHERE channel_no = $1 AND start_time_ns >= $2 AND start_time_ns < $3 AND (start_time_ns, id) {after} ($4, $5) {counted}
                ORDER BY start_time_ns {direction}, id {direction} LIMIT $6
             ) s {SERVED} ORDER BY s.start_time_ns {direction}, s.id {direction}"
        );
        let (after_ns, after_id) = SegmentKey::bound(filter.after.as_ref(), start)?;
        let rows = sqlx::query(&text)
            .bind(channel.channel_no)
            .bind(filter.from.map_or(Ok(i64::MIN), to_ns)?)
            .bind(filter.to.map_or(Ok(i64::MAX), to_ns)?)
            .bind(after_ns)
            .bind(after_id)
            .bind(i64::from(limit))
            .fetch_all(self.read())
            .await?;
        let layouts = self.layouts().load(&rows, &COLUMNS, self.read()).await?;
        rows.iter().map(|row| segment_of(row, &layouts)).collect()
    }
}

/// Decodes the input of the fold from a row.
fn features_of(row: &AnyRow, layouts: &Layouts) -> Result<StoredFeatures, StoreError> {
    let id: String = get(row, "id")?;
    Ok(StoredFeatures {
        excluded: get::<i64>(row, "excluded")? != 0,
        feature_key: get(row, "feature_key")?,
        features: layouts.read(row, "feature_values", &id)?,
        indicators: layouts.read(row, "indicator_values", &id)?,
        key: SegmentKey { start_time: get_time(row, "start_time_ns")?, id: SegmentId(id) },
    })
}

/// Decodes a segment without its estimate from a row.
pub(in crate::store) fn new_segment_of(row: &AnyRow, layouts: &Layouts) -> Result<NewSegment, StoreError> {
    let id: String = get(row, "id")?;
    let shaft_speed: Option<String> = get(row, "shaft_speed")?;
    let channel_index = get_count(row, "raw_channel_index")?;
    Ok(NewSegment {
        asset_id: asset_id(get(row, "asset_id")?)?,
        channel: get(row, "channel")?,
        start_time: get_time(row, "start_time_ns")?,
        received_at: get_time(row, "received_at_ns")?,
        sample_rate_hz: get(row, "sample_rate_hz")?,
        samples: get_count(row, "samples")?,
        unit: get(row, "unit")?,
        operating_point: get_json(row, "operating_point", &id)?,
        reference_wear_um: get(row, "reference_wear_um")?,
        raw: RawReference {
            sha256: get(row, "raw_sha256")?,
            bytes: get_count(row, "raw_bytes")?,
            media_type: get(row, "raw_media_type")?,
            channel_index: u32::try_from(channel_index).unwrap_or(u32::MAX),
        },
        excluded: get::<i64>(row, "excluded")? != 0,
        analysed: Analysed {
            keys: AnalysisKeys {
                analysis: get::<String>(row, "analysis_key")?.into(),
                feature: get::<String>(row, "feature_key")?.into(),
            },
            shaft_speed: shaft_speed.map(|text| from_json(&text, "shaft_speed", &id)).transpose()?,
            basis: get_json_or_default(row, "basis", &id)?,
            indicators: layouts.read(row, "indicator_values", &id)?,
            features: layouts.read(row, "feature_values", &id)?,
        },
        id: SegmentId(id),
    })
}

fn segment_of(row: &AnyRow, layouts: &Layouts) -> Result<Segment, StoreError> {
    let new = new_segment_of(row, layouts)?;
    let mut wear: WearEstimate = get_json(row, "estimate", &new.id.0)?;
    wear.posterior = layouts.read_posterior(row, &new.id.0)?;
    let indicators = layouts.read_or_default(row, "run_indicator_values", &new.id.0)?;
    Ok(new.with_run(RunResult { indicators, wear }))
}
