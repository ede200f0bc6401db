//! The small curve of a channel's wear in lists of assets: a few samples over its whole history, without
//! reading the history.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use crate::store::database::rows::{get, to_ns};
use crate::store::{ChannelSummary, Store, StoreError};

/// Number of samples over a history.
const PICKS: i64 = 40;

/// Maximum number of channels whose curves are cached.
const MAX_CHANNELS: usize = 10_000;

/// The cached curves by channel number.
#[derive(Debug, Default)]
pub(in crate::store) struct CurveCache(Mutex<HashMap<i64, CachedCurve>>);

#[derive(Debug)]
struct CachedCurve {
    /// The channel's revision at which it was read.
    revision: i64,
    curve: Arc<[f64]>,
}

impl Store {
    /// Returns medians of the wear depth in µm at up to 40 times, evenly spaced from the first record to the
    /// last; records without an estimate are skipped.
    pub async fn wear_curve(&self, channel: &ChannelSummary) -> Result<Arc<[f64]>, StoreError> {
        let (Some(first), Some(last)) = (channel.first_start_time, channel.last_start_time) else {
            return Ok(Arc::default());
        };
        let cache = &self.inner.curves.0;
        let cached = cache
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .get(&channel.channel_no)
            .filter(|cached| cached.revision >= channel.revision)
            .map(|cached| Arc::clone(&cached.curve));
        if let Some(curve) = cached {
            return Ok(curve);
        }
        let (first_ns, last_ns) = (to_ns(first)?, to_ns(last)?);
        // The first record at or after each time is one lookup in the index.
        let rows = sqlx::query(
            "WITH RECURSIVE moments (n, time_ns) AS (
                SELECT CAST(0 AS BIGINT), CAST($2 AS BIGINT)
                UNION ALL SELECT n + 1, time_ns + CAST($3 AS BIGINT) FROM moments WHERE n < $4
             )
             SELECT w.segment_id, w.median_um FROM moments m
             JOIN wear_estimates w ON w.segment_id = (
                SELECT s.id FROM segments s WHERE s.channel_no = $1 AND s.start_time_ns >= m.time_ns ORDER BY s.start_time_ns, s.id LIMIT 1
             )
             JOIN channels c ON c.channel_no = $1 AND w.generation = c.wear_generation
             ORDER BY m.n",
        )
        .bind(channel.channel_no)
        .bind(first_ns)
        .bind(last_ns.saturating_sub(first_ns) / (PICKS - 1))
        .bind(PICKS - 1)
        .fetch_all(self.read())
        .await?;
        let mut curve = Vec::with_capacity(rows.len());
        let mut before = String::new();
        for row in &rows {
            let id: String = get(row, "segment_id")?;
            let median_um: Option<f64> = get(row, "median_um")?;
            if id != before {
                curve.extend(median_um);
            }
            before = id;
        }
        let curve: Arc<[f64]> = curve.into();
        let mut cached = cache.lock().unwrap_or_else(PoisonError::into_inner);
        if cached.len() >= MAX_CHANNELS {
            cached.clear();
        }
        let entry = CachedCurve { revision: channel.revision, curve: Arc::clone(&curve) };
        cached.insert(channel.channel_no, entry);
        Ok(curve)
    }
}
