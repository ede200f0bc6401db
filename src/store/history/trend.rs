//! Histories of whole channels, cached in memory as columns.
//!
//! Reading 10⁵ rows takes more than a second, so a history stays in memory, and only records added since are
//! read; the channel's revisions tell whether that is enough. A history that is not in memory starts from its
//! stored blocks (`trend_blocks`).

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use jiff::Timestamp;
use sqlx::any::AnyRow;

use crate::asset::SegmentId;
use crate::estimate::WearStatus;
use crate::signal::{Indicators, OperatingPoint, ShaftSpeed};
use crate::store::assets::channel_of;
use crate::store::database::rows::{from_json, from_ns, get, get_json};
use crate::store::database::watched::WatchedTransaction;
use crate::store::layouts::Layouts;
use crate::store::{ChannelSummary, SegmentKey, Store, StoreError};

/// Maximum number of cached records of all channels, beyond which the least recently used histories are
/// dropped.
pub(in crate::store) const MAX_RECORDS: usize = 1_000_000;

/// The columns of a history's rows that have a layout.
pub(in crate::store) const COLUMNS: [&str; 2] = ["indicator_values", "run_indicator_values"];

/// Rows read in one query.
const ROWS_PER_QUERY: usize = 4096;

/// One channel's history in the order of time: parallel columns with one entry for each segment.
#[derive(Debug, Clone, Default)]
pub struct Trend {
    /// Time of each segment's first sample.
    pub start_time: Vec<Timestamp>,
    /// The segments.
    pub segment_id: Vec<SegmentId>,
    /// Unit of the latest segment's samples.
    pub unit: String,
    /// Values of each indicator by name; NaN if a segment does not have it.
    pub indicators: BTreeMap<String, Vec<f64>>,
    /// Rotational frequency of the shaft in hertz; NaN if unknown.
    pub shaft_speed_hz: Vec<f64>,
    /// Torque in N·m given with the record; NaN if none was given.
    pub torque_nm: Vec<f64>,
    /// The wear estimates.
    pub wear: Vec<WearPoint>,
    channel_no: i64,
    revision: i64,
}

/// The wear estimate of one segment without its posterior.
#[derive(Debug, Clone, PartialEq, serde::Serialize, utoipa::ToSchema)]
#[schema(as = SegmentWear)]
pub struct WearPoint {
    /// Status of the estimate.
    pub status: WearStatus,
    /// Reason of the status.
    #[schema(value_type = String)]
    pub reason: Box<str>,
    /// Median wear depth in µm.
    pub median_um: Option<f64>,
    /// Mean wear depth in µm.
    pub mean_um: Option<f64>,
    /// Lower end of the 90 % interval of the wear depth in µm.
    pub low_um: Option<f64>,
    /// 25 % quantile of wear depth in µm.
    pub p25_um: Option<f64>,
    /// 75 % quantile of wear depth in µm.
    pub p75_um: Option<f64>,
    /// Upper end of the 90 % interval in µm.
    pub high_um: Option<f64>,
    /// Wear depth in µm known from another source.
    pub reference_wear_um: Option<f64>,
    /// Natural logarithm of the record's evidence under the library.
    pub log_evidence: Option<f64>,
}

impl Trend {
    /// Number of segments.
    pub fn len(&self) -> usize {
        self.segment_id.len()
    }

    /// Whether there is no segment.
    pub fn is_empty(&self) -> bool {
        self.segment_id.is_empty()
    }

    /// Positions of the segments that start at `from` or later and before `to`.
    pub fn range(&self, from: Option<Timestamp>, to: Option<Timestamp>) -> std::ops::Range<usize> {
        let low = from.map_or(0, |from| self.start_time.partition_point(|time| *time < from));
        let high = to.map_or(self.len(), |to| self.start_time.partition_point(|time| *time < to));
        low..high.max(low)
    }

    /// Makes room for a number of records, in all but the columns of indicators.
    pub(in crate::store) fn reserve(&mut self, records: usize) {
        self.start_time.reserve(records);
        self.segment_id.reserve(records);
        self.wear.reserve(records);
        self.shaft_speed_hz.reserve(records);
        self.torque_nm.reserve(records);
    }

    pub(in crate::store) fn push(&mut self, row: &AnyRow, layouts: &Layouts) -> Result<(), StoreError> {
        let id: String = get(row, "id")?;
        let mut indicators: Indicators = layouts.read(row, "indicator_values", &id)?;
        indicators.extend(layouts.read_or_default(row, "run_indicator_values", &id)?);
        let status: String = get(row, "status")?;
        let position = self.len();
        for (name, value) in indicators.values {
            let column = self.indicators.entry(name.to_string()).or_default();
            column.resize(position, f64::NAN);
            column.push(value);
        }
        self.wear.push(WearPoint {
            status: from_json(&format!("\"{status}\""), "status", &id)?,
            reason: get::<String>(row, "reason")?.into_boxed_str(),
            median_um: get(row, "median_um")?,
            mean_um: get(row, "mean_um")?,
            low_um: get(row, "low_um")?,
            p25_um: get(row, "p25_um")?,
            p75_um: get(row, "p75_um")?,
            high_um: get(row, "high_um")?,
            log_evidence: get(row, "log_evidence")?,
            reference_wear_um: get(row, "reference_wear_um")?,
        });
        let speed: Option<String> = get(row, "shaft_speed")?;
        let speed: Option<ShaftSpeed> = speed.map(|text| from_json(&text, "shaft_speed", &id)).transpose()?;
        let operating_point: OperatingPoint = get_json(row, "operating_point", &id)?;
        self.shaft_speed_hz.push(speed.map_or(f64::NAN, |speed| speed.shaft_speed_hz));
        self.torque_nm.push(operating_point.torque_nm.unwrap_or(f64::NAN));
        self.unit = get(row, "unit")?;
        self.start_time.push(from_ns(get(row, "start_time_ns")?));
        self.segment_id.push(SegmentId(id));
        Ok(())
    }

    /// Extends all columns to the number of records.
    pub(in crate::store) fn fill(&mut self) {
        let records = self.len();
        for column in self.indicators.values_mut() {
            column.resize(records, f64::NAN);
        }
    }

    fn last(&self) -> Option<SegmentKey> {
        let (start_time, id) = self.start_time.last().zip(self.segment_id.last())?;
        Some(SegmentKey { start_time: *start_time, id: id.clone() })
    }
}

/// The cached histories.
#[derive(Debug, Default)]
pub(in crate::store) struct TrendCache {
    cached: Mutex<CachedTrends>,
    reading: tokio::sync::Mutex<()>,
}

#[derive(Debug, Default)]
struct CachedTrends {
    /// By channel number: the history, and the access count at its last use.
    trends: HashMap<i64, (Arc<Trend>, u64)>,
    accesses: u64,
}

impl TrendCache {
    fn lock(&self) -> MutexGuard<'_, CachedTrends> {
        // Entries are replaced as a whole, so a panic elsewhere cannot leave a partial one.
        self.cached.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn get(&self, channel_no: i64) -> Option<Arc<Trend>> {
        let mut cached = self.lock();
        cached.accesses += 1;
        let now = cached.accesses;
        let (trend, last_access) = cached.trends.get_mut(&channel_no)?;
        *last_access = now;
        Some(Arc::clone(trend))
    }

    /// Removes a history from the cache.
    pub(in crate::store) fn remove(&self, channel_no: i64) -> Option<Arc<Trend>> {
        self.lock().trends.remove(&channel_no).map(|(trend, _)| trend)
    }

    fn put(&self, trend: Arc<Trend>) {
        let mut cached = self.lock();
        let now = cached.accesses;
        cached.trends.insert(trend.channel_no, (trend, now));
        let mut records: usize = cached.trends.values().map(|(trend, _)| trend.len()).sum();
        while records > MAX_RECORDS && cached.trends.len() > 1 {
            let Some((&oldest, _)) = cached.trends.iter().min_by_key(|(_, (_, last_access))| *last_access)
            else {
                break;
            };
            if let Some((trend, _)) = cached.trends.remove(&oldest) {
                records -= trend.len();
            }
        }
    }
}

impl Store {
    /// The history of a channel, at least as recent as its summary.
    pub async fn trend(&self, channel: &ChannelSummary) -> Result<Arc<Trend>, StoreError> {
        let current = |trend: &Arc<Trend>| trend.revision >= channel.revision;
        if let Some(trend) = self.inner.trends.get(channel.channel_no).filter(current) {
            return Ok(trend);
        }
        // One reader at a time updates a history; the next ones find it updated.
        let _guard = self.inner.trends.reading.lock().await;
        let mut trend = match self.inner.trends.remove(channel.channel_no) {
            Some(trend) if current(&trend) => {
                self.inner.trends.put(Arc::clone(&trend));
                return Ok(trend);
            }
            Some(trend) if trend.revision >= channel.rewritten_revision => trend,
            _ => Arc::new(Trend { channel_no: channel.channel_no, ..Trend::default() }),
        };
        // It is removed from the cache first, so that `make_mut` copies it only if a reader still uses it.
        self.append(Arc::make_mut(&mut trend), channel).await?;
        self.inner.trends.put(Arc::clone(&trend));
        Ok(trend)
    }

    async fn append(&self, trend: &mut Trend, channel: &ChannelSummary) -> Result<(), StoreError> {
        // One database snapshot for all queries: if the history is replaced in the meantime, either the old
        // or the new one is read.
        let mut snapshot = self.read().begin_with(self.dialect().begin_snapshot()).await?;
        let row = sqlx::query("SELECT * FROM channels WHERE channel_no = $1")
            .bind(channel.channel_no)
            .fetch_optional(&mut *snapshot)
            .await?;
        let Some(row) = row else { return Ok(()) };
        let channel = channel_of(&row)?;
        if trend.revision < channel.rewritten_revision {
            *trend = Trend { channel_no: channel.channel_no, ..Trend::default() };
        }
        if trend.is_empty() {
            super::trend_blocks::load(&mut snapshot, &channel, trend).await?;
        }
        loop {
            let rows = rows_after(&mut snapshot, &channel, trend.last().as_ref(), ROWS_PER_QUERY).await?;
            let layouts = self.layouts().load(&rows, &COLUMNS, &mut *snapshot).await?;
            for row in &rows {
                trend.push(row, &layouts)?;
            }
            if rows.len() < ROWS_PER_QUERY {
                break;
            }
        }
        trend.fill();
        trend.revision = channel.revision;
        Ok(())
    }
}

/// Rows of a channel's history after a segment, or from its start.
pub(in crate::store) async fn rows_after(
    snapshot: &mut WatchedTransaction,
    channel: &ChannelSummary,
    after: Option<&SegmentKey>,
    max: usize,
) -> Result<Vec<AnyRow>, StoreError> {
    let (after_ns, after_id) = SegmentKey::bound(after, i64::MIN)?;
    let rows = sqlx::query(
        "SELECT s.id, s.start_time_ns, s.unit, s.operating_point, a.shaft_speed, a.indicator_values, w.run_indicator_values, s.reference_wear_um, w.status, w.reason, w.median_um, w.mean_um,
            w.low_um, w.p25_um, w.p75_um, w.high_um, w.log_evidence
         FROM segments s
         JOIN analyses a ON a.segment_id = s.id AND a.generation = $5
         JOIN wear_estimates w ON w.segment_id = s.id AND w.generation = $6
         WHERE s.channel_no = $1 AND (s.start_time_ns, s.id) > ($2, $3) ORDER BY s.start_time_ns, s.id LIMIT $4",
    )
    .bind(channel.channel_no)
    .bind(after_ns)
    .bind(after_id)
    .bind(max as i64)
    .bind(channel.analysis_generation)
    .bind(channel.wear_generation)
    .fetch_all(&mut **snapshot)
    .await?;
    Ok(rows)
}
