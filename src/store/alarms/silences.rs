//! Silent channels: when their latest records were received.

use jiff::Timestamp;

use crate::asset::AssetId;
use crate::store::assets::{asset_of, channel_of};
use crate::store::database::rows::{from_ns, get};
use crate::store::{Asset, ChannelSummary, Store, StoreError};

/// Number of latest records of a channel, by start time, that count: receiving an old record does not end a
/// silence.
const LATEST: u32 = 8;

/// A channel, and when it last received one of its latest records.
#[derive(Debug)]
pub struct Silence {
    /// The channel.
    pub channel: ChannelSummary,
    /// The time of receipt.
    pub since: Timestamp,
}

impl Store {
    /// The assets with a silence rule.
    pub async fn assets_with_rules_on_silence(&self) -> Result<Vec<Asset>, StoreError> {
        let rows = sqlx::query("SELECT * FROM assets WHERE spec LIKE '%\"stale_s\"%' ORDER BY id")
            .fetch_all(self.read())
            .await?;
        rows.iter().map(asset_of).collect()
    }

    /// The silence of each channel of these assets.
    pub async fn silences(&self, assets: &[&AssetId]) -> Result<Vec<Silence>, StoreError> {
        let text = |these: &str| {
            format!(
                "SELECT c.*, (SELECT MAX(r.received_at_ns) FROM (
                     SELECT s.received_at_ns FROM segments s WHERE s.channel_no = c.channel_no
                     ORDER BY s.start_time_ns DESC, s.id DESC LIMIT {LATEST}) r) AS since_ns
                 FROM channels c WHERE c.segments > 0 AND c.asset_id IN ({these}) ORDER BY c.channel_no"
            )
        };
        let rows = self.rows_of_assets(assets, text).await?;
        let silence = |row| {
            let since: Option<i64> = get(row, "since_ns")?;
            let channel = channel_of(row)?;
            Ok(since.map(|since| Silence { channel, since: from_ns(since) }))
        };
        rows.iter().filter_map(|row| silence(row).transpose()).collect()
    }
}
