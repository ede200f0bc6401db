//! Writing the rows that a transaction adds to channels: segments, analyses, estimates and states of the
//! fold, each kind for all channels at once.
//!
//! A statement costs a round trip to the database while rows are locked, so many rows are written by each
//! statement.

use std::collections::{BTreeMap, HashSet};

use jiff::Timestamp;

use super::fold_states::StatesAfter;
use super::wear_rows::WearRow;
use crate::asset::SegmentId;
use crate::store::database::rows::{finite, finite_or_none, get, rows_of_placeholders, to_json, to_ns};
use crate::store::layouts::Columns;
use crate::store::transaction::{ROWS_PER_STATEMENT, Transaction};
use crate::store::{
    Analysed, ChannelSummary, NewSegment, RunResult, SegmentKey, StoreError, StoredFoldState,
};

/// The rows that a transaction adds to a channel, in the served generations.
#[derive(Debug)]
pub struct ChannelRows<'a> {
    /// The channel, whose row the transaction has locked; its summary is updated.
    pub channel: &'a mut ChannelSummary,
    /// New segments.
    pub new: Vec<&'a NewSegment>,
    /// New or changed estimates of segments.
    pub wears: &'a [(SegmentKey, RunResult)],
    /// A position, and the states of the fold, in ascending order, that replace all states after it; `None`
    /// if the states are unchanged.
    pub states: Option<(u64, Vec<StoredFoldState>)>,
    /// Whether estimates of earlier segments changed.
    pub is_rewritten: bool,
}

/// The rows of all channels, by table.
#[derive(Default)]
struct Rows<'a> {
    segments: Vec<(i64, &'a NewSegment)>,
    analyses: Vec<(i64, &'a SegmentId, &'a Analysed)>,
    wears: Vec<WearRow<'a>>,
    states: Vec<StatesAfter<'a>>,
    channels: Vec<&'a ChannelSummary>,
}

impl<'a> Rows<'a> {
    fn take(&mut self, addition: &'a ChannelRows<'_>) {
        let channel = &*addition.channel;
        for segment in &addition.new {
            self.segments.push((channel.channel_no, segment));
            self.analyses.push((channel.analysis_generation, &segment.id, &segment.analysed));
        }
        let new: HashSet<&SegmentId> = addition.new.iter().map(|segment| &segment.id).collect();
        let wears = addition.wears.iter().map(|(key, result)| WearRow {
            generation: channel.wear_generation,
            segment: &key.id,
            result,
            is_first: new.contains(&key.id),
        });
        self.wears.extend(wears);
        if let Some((after, states)) = &addition.states {
            self.states.push((channel.channel_no, channel.wear_generation, *after, states));
        }
        self.channels.push(channel);
    }
}

impl ChannelSummary {
    fn add(&mut self, segment: &NewSegment) {
        self.mark_changed(segment.key());
        self.segments += 1;
        if self.first_start_time.is_none_or(|first| segment.start_time < first) {
            self.first_start_time = Some(segment.start_time);
        }
        let last = self.last_start_time.zip(self.last_segment.as_ref());
        if last.is_none_or(|last| last < (segment.start_time, &segment.id)) {
            self.last_start_time = Some(segment.start_time);
            self.last_segment = Some(segment.id.clone());
        }
    }
}

impl Transaction {
    /// Adds rows to channels, each channel at most once.
    pub async fn add(&mut self, additions: &mut [ChannelRows<'_>]) -> Result<(), StoreError> {
        for addition in &mut *additions {
            addition.new.iter().for_each(|segment| addition.channel.add(segment));
            addition.channel.count_change(addition.is_rewritten);
        }
        let mut rows = Rows::default();
        for addition in &*additions {
            rows.take(addition);
        }
        self.insert_segments(&rows.segments).await?;
        self.insert_analyses(&rows.analyses).await?;
        self.count_raw(&rows.segments).await?;
        self.set_wears(&rows.wears).await?;
        self.set_states(&rows.states).await?;
        self.set_channels(&rows.channels).await
    }

    /// Inserts segments with their channel numbers, without their results.
    async fn insert_segments(&mut self, segments: &[(i64, &NewSegment)]) -> Result<(), StoreError> {
        for chunk in segments.chunks(ROWS_PER_STATEMENT) {
            let text = format!(
                "INSERT INTO segments (id, channel_no, start_time_ns, received_at_ns, sample_rate_hz, samples, unit, operating_point,
                    reference_wear_um, raw_sha256, raw_bytes, raw_media_type, raw_channel_index, excluded)
                 VALUES {}",
                rows_of_placeholders(chunk.len(), 14)
            );
            let mut query = sqlx::query(&text);
            for (channel_no, segment) in chunk {
                let id = segment.id.0.as_str();
                query = query
                    .bind(id)
                    .bind(*channel_no)
                    .bind(to_ns(segment.start_time)?)
                    .bind(to_ns(segment.received_at)?)
                    .bind(finite("sample_rate_hz", segment.sample_rate_hz)?)
                    .bind(i64::try_from(segment.samples).unwrap_or(i64::MAX))
                    .bind(segment.unit.as_str())
                    .bind(to_json(&segment.operating_point, "operating_point", id)?)
                    .bind(finite_or_none("reference_wear_um", segment.reference_wear_um)?)
                    .bind(segment.raw.sha256.as_str())
                    .bind(i64::try_from(segment.raw.bytes).unwrap_or(i64::MAX))
                    .bind(segment.raw.media_type.as_str())
                    .bind(i64::from(segment.raw.channel_index))
                    .bind(i64::from(segment.excluded));
            }
            query.persistent(self.dialect.caches_optional_doubles()).execute(&mut *self.inner).await?;
        }
        Ok(())
    }

    /// Inserts analyses of segments with their generations; existing ones are kept.
    pub(in crate::store) async fn insert_analyses(
        &mut self,
        analyses: &[(i64, &SegmentId, &Analysed)],
    ) -> Result<(), StoreError> {
        for chunk in analyses.chunks(ROWS_PER_STATEMENT) {
            let text = format!(
                "INSERT INTO analyses (segment_id, generation, analysis_key, feature_key, shaft_speed, basis, indicator_values, feature_values)
                 VALUES {} ON CONFLICT (segment_id, generation) DO NOTHING",
                rows_of_placeholders(chunk.len(), 8)
            );
            let mut columns = Vec::with_capacity(2 * chunk.len());
            for (_, segment, analysed) in chunk {
                let id = segment.0.as_str();
                for (name, value) in &analysed.indicators.values {
                    finite(&format!("indicator {name} of segment {id}"), *value)?;
                }
                for (name, value) in &analysed.features.values {
                    finite(&format!("feature {name} of segment {id}"), *value)?;
                }
                columns.push(Columns::of(&analysed.indicators, "indicator_values", id)?);
                columns.push(Columns::of(&analysed.features, "feature_values", id)?);
            }
            self.store_layouts(&columns).await?;
            let mut query = sqlx::query(&text);
            for ((generation, segment, analysed), columns) in chunk.iter().zip(columns.as_chunks::<2>().0) {
                let id = segment.0.as_str();
                let [indicators, features] = columns;
                let shaft_speed = analysed.shaft_speed.as_ref();
                query = query
                    .bind(id)
                    .bind(*generation)
                    .bind(&*analysed.keys.analysis)
                    .bind(&*analysed.keys.feature)
                    .bind(shaft_speed.map(|speed| to_json(speed, "shaft_speed", id)).transpose()?)
                    .bind(to_json(&analysed.basis, "basis", id)?)
                    .bind(indicators.bytes.as_slice())
                    .bind(features.bytes.as_slice());
            }
            query.persistent(self.dialect.caches_statement(chunk.len())).execute(&mut *self.inner).await?;
        }
        Ok(())
    }

    /// Adds the raw objects of segments to the volumes of their assets, each object once.
    async fn count_raw(&mut self, segments: &[(i64, &NewSegment)]) -> Result<(), StoreError> {
        // In the same order in all transactions, to avoid deadlocks.
        let mut objects: BTreeMap<(&str, &str), (i64, Timestamp)> = BTreeMap::new();
        for (_, segment) in segments {
            let name = (segment.raw.sha256.as_str(), segment.asset_id.as_str());
            let bytes = i64::try_from(segment.raw.bytes).unwrap_or(i64::MAX);
            objects.entry(name).or_insert((bytes, segment.start_time));
        }
        let objects: Vec<_> = objects.into_iter().collect();
        let mut volumes: BTreeMap<String, i64> = BTreeMap::new();
        for chunk in objects.chunks(ROWS_PER_STATEMENT) {
            let text = format!(
                "INSERT INTO raw_objects (sha256, asset_id, bytes, start_time_ns) VALUES {}
                 ON CONFLICT (sha256, asset_id) DO NOTHING RETURNING asset_id, bytes",
                rows_of_placeholders(chunk.len(), 4)
            );
            let mut query = sqlx::query(&text).persistent(self.dialect.caches_statement(chunk.len()));
            for ((sha256, asset), (bytes, start_time)) in chunk {
                query = query.bind(*sha256).bind(*asset).bind(*bytes).bind(to_ns(*start_time)?);
            }
            for row in query.fetch_all(&mut *self.inner).await? {
                let volume = volumes.entry(get(&row, "asset_id")?).or_default();
                *volume = volume.saturating_add(get(&row, "bytes")?);
            }
        }
        let volumes: Vec<_> = volumes.into_iter().collect();
        for chunk in volumes.chunks(ROWS_PER_STATEMENT) {
            let text = format!(
                "INSERT INTO raw_volumes (asset_id, bytes) VALUES {}
                 ON CONFLICT (asset_id) DO UPDATE SET bytes = raw_volumes.bytes + excluded.bytes",
                rows_of_placeholders(chunk.len(), 2)
            );
            let query = sqlx::query(&text).persistent(self.dialect.caches_statement(chunk.len()));
            let query =
                chunk.iter().fold(query, |query, (asset, bytes)| query.bind(asset.as_str()).bind(*bytes));
            query.execute(&mut *self.inner).await?;
        }
        Ok(())
    }
}
