//! The results of the latest record of each channel of all assets.

use std::collections::HashMap;
use std::sync::Arc;

use jiff::Timestamp;
use tokio::sync::Mutex;

use crate::signal::Indicators;
use crate::store::database::rows::{get, get_time, placeholders};
use crate::store::{Store, StoreError};

/// Channels read in one query.
const CHANNELS_PER_QUERY: usize = 500;

/// Maximum number of channels whose latest records are cached, each with some 2 kB.
const MAX_CHANNELS: usize = 20_000;

/// The results of the latest record of a channel.
#[derive(Debug, Clone, PartialEq)]
pub struct LatestRecord {
    /// The asset's name.
    pub asset: String,
    /// The channel.
    pub channel: String,
    /// Time of the first sample.
    pub start_time: Timestamp,
    /// Lower end of the 90 % interval of the wear depth in µm, its quartiles, and the upper end.
    pub wear_um: [Option<f64>; 5],
    /// Its indicators, including those that depend on the earlier records.
    pub indicators: Indicators,
}

/// The cached records by channel number. One reader at a time brings them up to date.
#[derive(Debug, Default)]
pub(in crate::store) struct LatestRecordCache(Mutex<HashMap<i64, CachedRecord>>);

#[derive(Debug)]
struct CachedRecord {
    /// The channel's revision at which it was read.
    revision: i64,
    record: Arc<LatestRecord>,
}

impl Store {
    /// The latest records of all channels, in the order of assets and channels. Only those of channels that
    /// have changed since the last call are read.
    pub async fn latest_records(&self) -> Result<Vec<Arc<LatestRecord>>, StoreError> {
        let mut cached = self.inner.latest_records.0.lock().await;
        let revisions = self.channel_revisions().await?;
        cached.retain(|channel, known| {
            revisions.get(channel).is_some_and(|revision| *revision <= known.revision)
        });
        let changed: Vec<i64> =
            revisions.keys().filter(|channel| !cached.contains_key(channel)).copied().collect();
        for channels in changed.chunks(CHANNELS_PER_QUERY) {
            for (channel, record) in self.latest_records_of(channels).await? {
                // The record may be newer: then it is read once more.
                let revision = revisions.get(&channel).copied().unwrap_or(0);
                cached.insert(channel, CachedRecord { revision, record: Arc::new(record) });
            }
        }
        let mut records: Vec<_> = cached.values().map(|known| Arc::clone(&known.record)).collect();
        if cached.len() > MAX_CHANNELS {
            cached.clear();
        }
        drop(cached);
        records.sort_by(|a, b| (&a.asset, &a.channel).cmp(&(&b.asset, &b.channel)));
        Ok(records)
    }

    /// The revision of each channel by its number. They are read as one text, as the driver takes longer for
    /// ten thousand rows than the database.
    async fn channel_revisions(&self) -> Result<HashMap<i64, i64>, StoreError> {
        let all = self.dialect().joined("channel_no || ' ' || revision", " ");
        let row = sqlx::query(&format!("SELECT COALESCE({all}, '') AS revisions FROM channels"))
            .fetch_one(self.read())
            .await?;
        let text: String = get(&row, "revisions")?;
        let numbers: Option<Vec<i64>> =
            text.split_ascii_whitespace().map(|number| number.parse().ok()).collect();
        let numbers = numbers.ok_or_else(|| StoreError::Unexpected {
            what: "revisions",
            value: text.chars().take(100).collect(),
            expected: "whole numbers",
        })?;
        Ok(numbers.as_chunks().0.iter().map(|[channel, revision]| (*channel, *revision)).collect())
    }

    async fn latest_records_of(&self, channels: &[i64]) -> Result<Vec<(i64, LatestRecord)>, StoreError> {
        let text = format!(
            "SELECT c.channel_no, c.asset_id, c.name, s.start_time_ns, a.indicator_values, w.run_indicator_values, w.low_um, w.p25_um, w.median_um, w.p75_um, w.high_um
             FROM channels c
             JOIN segments s ON s.id = c.last_segment_id
             JOIN analyses a ON a.segment_id = s.id AND a.generation = c.analysis_generation
             JOIN wear_estimates w ON w.segment_id = s.id AND w.generation = c.wear_generation
             WHERE c.channel_no IN ({})",
            placeholders(1, channels.len())
        );
        let query = sqlx::query(&text).persistent(self.dialect().caches_statement(channels.len()));
        let query = channels.iter().fold(query, |query, channel| query.bind(*channel));
        let rows = query.fetch_all(self.read()).await?;
        let layouts =
            self.layouts().load(&rows, &["indicator_values", "run_indicator_values"], self.read()).await?;
        let record = |row| {
            let channel: String = get(row, "name")?;
            let mut indicators: Indicators = layouts.read(row, "indicator_values", &channel)?;
            indicators.extend(layouts.read_or_default(row, "run_indicator_values", &channel)?);
            let record = LatestRecord {
                asset: get(row, "asset_id")?,
                start_time: get_time(row, "start_time_ns")?,
                wear_um: [
                    get(row, "low_um")?,
                    get(row, "p25_um")?,
                    get(row, "median_um")?,
                    get(row, "p75_um")?,
                    get(row, "high_um")?,
                ],
                channel,
                indicators,
            };
            Ok((get(row, "channel_no")?, record))
        };
        rows.iter().map(record).collect()
    }
}
