//! The results of the latest record of each channel of all assets.

use jiff::Timestamp;

use super::rows::{get, get_time};
use super::{Store, StoreError};
use crate::signal::Indicators;

/// Channels read in one query.
const CHANNELS_AT_ONCE: i64 = 500;

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

impl Store {
    /// The latest records of up to 500 channels after the given one, in the order of assets and channels.
    pub async fn latest_records(&self, after: Option<(&str, &str)>) -> Result<Vec<LatestRecord>, StoreError> {
        let (asset, channel) = after.unwrap_or(("", ""));
        let rows = sqlx::query(
            "SELECT c.asset_id, c.name, s.start_time_ns, a.indicator_values, w.run_indicator_values, w.low_um, w.p25_um, w.median_um, w.p75_um, w.high_um
             FROM channels c
             JOIN segments s ON s.id = c.last_segment_id
             JOIN analyses a ON a.segment_id = s.id AND a.generation = c.analysis_generation
             JOIN wear_estimates w ON w.segment_id = s.id AND w.generation = c.wear_generation
             WHERE (c.asset_id, c.name) > ($1, $2) ORDER BY c.asset_id, c.name LIMIT $3",
        )
        .bind(asset)
        .bind(channel)
        .bind(CHANNELS_AT_ONCE)
        .fetch_all(self.read())
        .await?;
        let layouts =
            self.layouts().of(&rows, &["indicator_values", "run_indicator_values"], self.read()).await?;
        let record = |row| {
            let channel: String = get(row, "name")?;
            let mut indicators: Indicators = layouts.read(row, "indicator_values", &channel)?;
            indicators.extend(layouts.read_or_default(row, "run_indicator_values", &channel)?);
            Ok(LatestRecord {
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
            })
        };
        rows.iter().map(record).collect()
    }
}
