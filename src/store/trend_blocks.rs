//! Blocks of a long history stored as columns, in addition to its rows, so that a history that is not in
//! memory can be read quickly.

use std::collections::BTreeMap;

use futures_util::TryStreamExt;
use prost::Message;
use sqlx::{Any, Transaction};

use super::assets::channel_of;
use super::rows::{from_json, from_ns, get, to_json, to_ns};
use super::trend::{self, Trend, WearPoint, rows_after};
use super::{ChannelSummary, SegmentKey, Store, StoreError};
use crate::asset::SegmentId;

/// Number of records in a block.
pub(super) const RECORDS: usize = 1024;

/// Version of the block format; incremented with every change of it.
const FORMAT: i64 = 1;

/// Maximum number of channels in one round.
const MAX_CHANNELS: i64 = 100;

/// The columns of a block.
#[derive(Clone, PartialEq, Message)]
struct Block {
    #[prost(sfixed64, repeated, tag = "1")]
    start_time_ns: Vec<i64>,
    #[prost(string, repeated, tag = "2")]
    segment_id: Vec<String>,
    #[prost(string, tag = "3")]
    unit: String,
    #[prost(message, repeated, tag = "4")]
    indicators: Vec<Column>,
    #[prost(double, repeated, tag = "5")]
    shaft_speed_hz: Vec<f64>,
    #[prost(double, repeated, tag = "6")]
    torque_nm: Vec<f64>,
    #[prost(string, repeated, tag = "7")]
    status: Vec<String>,
    #[prost(string, repeated, tag = "8")]
    reason: Vec<String>,
    /// The numbers of [`numbers_of`], record after record; NaN for a missing number.
    #[prost(double, repeated, tag = "9")]
    wear: Vec<f64>,
}

/// An indicator's values.
#[derive(Clone, PartialEq, Message)]
struct Column {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(double, repeated, tag = "2")]
    values: Vec<f64>,
}

/// Count of numbers of an estimate.
const NUMBERS: usize = 8;

fn numbers_of(wear: &WearPoint) -> [Option<f64>; NUMBERS] {
    [
        wear.median_um,
        wear.mean_um,
        wear.low_um,
        wear.p25_um,
        wear.p75_um,
        wear.high_um,
        wear.log_evidence,
        wear.reference_wear_um,
    ]
}

impl Block {
    fn of(trend: &Trend) -> Result<Self, StoreError> {
        let column =
            |(name, values): (&String, &Vec<f64>)| Column { name: name.clone(), values: values.clone() };
        let status =
            |wear: &WearPoint| Ok(to_json(&wear.status, "status", "a history")?.trim_matches('"').to_owned());
        Ok(Self {
            start_time_ns: trend.start_time.iter().map(|time| to_ns(*time)).collect::<Result<_, _>>()?,
            segment_id: trend.segment_id.iter().map(|id| id.0.clone()).collect(),
            unit: trend.unit.clone(),
            indicators: trend.indicators.iter().map(column).collect(),
            shaft_speed_hz: trend.shaft_speed_hz.clone(),
            torque_nm: trend.torque_nm.clone(),
            status: trend.wear.iter().map(status).collect::<Result<_, StoreError>>()?,
            reason: trend.wear.iter().map(|wear| wear.reason.to_string()).collect(),
            wear: trend.wear.iter().flat_map(numbers_of).map(|number| number.unwrap_or(f64::NAN)).collect(),
        })
    }

    /// Whether all columns have the right length.
    fn is_whole(&self) -> bool {
        let lengths = [
            self.start_time_ns.len(),
            self.segment_id.len(),
            self.shaft_speed_hz.len(),
            self.torque_nm.len(),
            self.status.len(),
            self.reason.len(),
        ];
        lengths == [RECORDS; 6]
            && self.wear.len() == RECORDS * NUMBERS
            && self.indicators.iter().all(|column| column.values.len() == RECORDS)
    }

    fn append_to(self, trend: &mut Trend) -> Result<(), StoreError> {
        let position = trend.len();
        for Column { name, values } in self.indicators {
            let column = trend.indicators.entry(name).or_default();
            column.resize(position, f64::NAN);
            column.extend(values);
        }
        // A block contains only a few different statuses.
        let mut statuses = BTreeMap::new();
        let numbers = self.wear.as_chunks::<NUMBERS>().0;
        for ((status, reason), numbers) in self.status.into_iter().zip(self.reason).zip(numbers) {
            let known = statuses.get(&status).copied();
            let status = match known {
                Some(status) => status,
                None => {
                    let read = from_json(&format!("\"{status}\""), "status", "a history")?;
                    *statuses.entry(status).or_insert(read)
                }
            };
            let number = |place: usize| Some(numbers[place]).filter(|number| !number.is_nan());
            trend.wear.push(WearPoint {
                status,
                reason: reason.into_boxed_str(),
                median_um: number(0),
                mean_um: number(1),
                low_um: number(2),
                p25_um: number(3),
                p75_um: number(4),
                high_um: number(5),
                log_evidence: number(6),
                reference_wear_um: number(7),
            });
        }
        trend.unit = self.unit;
        trend.start_time.extend(self.start_time_ns.into_iter().map(from_ns));
        trend.segment_id.extend(self.segment_id.into_iter().map(SegmentId));
        trend.shaft_speed_hz.extend(self.shaft_speed_hz);
        trend.torque_nm.extend(self.torque_nm);
        Ok(())
    }
}

/// Starts a history from its stored blocks.
pub(super) async fn load(
    snapshot: &mut Transaction<'_, Any>,
    channel: &ChannelSummary,
    trend: &mut Trend,
) -> Result<(), StoreError> {
    // Each block is decoded while the database reads the next one.
    let mut rows = sqlx::query(
        "SELECT number, columns FROM trend_blocks WHERE channel_no = $1 AND revision >= $2 AND format = $3 ORDER BY number",
    )
    .bind(channel.channel_no)
    .bind(channel.rewritten_revision)
    .bind(FORMAT)
    .fetch(&mut **snapshot);
    let mut expected = 0;
    while let Some(row) = rows.try_next().await? {
        let number: i64 = get(&row, "number")?;
        // An unreadable block, and those after it, are read from the rows.
        let block = Block::decode(get::<&[u8]>(&row, "columns")?).ok().filter(Block::is_whole);
        let Some(block) = block.filter(|_| number == expected) else { break };
        block.append_to(trend)?;
        expected += 1;
    }
    Ok(())
}

impl Store {
    /// Stores the missing blocks of long histories.
    pub async fn store_trend_blocks(&self) -> Result<(), StoreError> {
        self.check_whole()?;
        let lacking = sqlx::query(
            "SELECT * FROM channels c WHERE c.segments >= $1 AND c.segments >= $1 * (1 + (
                SELECT COUNT(*) FROM trend_blocks b
                WHERE b.channel_no = c.channel_no AND b.revision >= c.rewritten_revision AND b.format = $2
             )) LIMIT $3",
        )
        .bind(RECORDS as i64)
        .bind(FORMAT)
        .bind(MAX_CHANNELS)
        .fetch_all(self.read())
        .await?;
        for row in &lacking {
            let channel = channel_of(row)?;
            while self.store_next_block(&channel).await? {}
        }
        Ok(())
    }

    /// Number of valid stored blocks of an asset's histories.
    pub async fn trend_blocks(&self, asset: &str) -> Result<u64, StoreError> {
        let row = sqlx::query(
            "SELECT COUNT(*) AS blocks FROM trend_blocks b JOIN channels c ON c.channel_no = b.channel_no
             WHERE c.asset_id = $1 AND b.revision >= c.rewritten_revision AND b.format = $2",
        )
        .bind(asset)
        .bind(FORMAT)
        .fetch_one(self.read())
        .await?;
        super::rows::get_count(&row, "blocks")
    }

    /// Stores the next block of a history; returns false if there are not enough records.
    async fn store_next_block(&self, channel: &ChannelSummary) -> Result<bool, StoreError> {
        let mut snapshot = self.read().begin_with(self.dialect().begin_snapshot()).await?;
        let row = sqlx::query("SELECT * FROM channels WHERE channel_no = $1")
            .bind(channel.channel_no)
            .fetch_optional(&mut *snapshot)
            .await?;
        let Some(row) = row else { return Ok(false) };
        let channel = channel_of(&row)?;
        let before = sqlx::query(
            "SELECT number, last_start_ns, last_segment_id FROM trend_blocks
             WHERE channel_no = $1 AND revision >= $2 AND format = $3 ORDER BY number DESC LIMIT 1",
        )
        .bind(channel.channel_no)
        .bind(channel.rewritten_revision)
        .bind(FORMAT)
        .fetch_optional(&mut *snapshot)
        .await?;
        let (number, after) = match before {
            None => (0, None),
            Some(row) => {
                let id = SegmentId(get(&row, "last_segment_id")?);
                let start_time = from_ns(get(&row, "last_start_ns")?);
                (get::<i64>(&row, "number")? + 1, Some(SegmentKey { start_time, id }))
            }
        };
        let mut trend = Trend::default();
        let rows = rows_after(&mut snapshot, &channel, after.as_ref(), RECORDS).await?;
        if rows.len() < RECORDS {
            return Ok(false);
        }
        let layouts = self.layouts().of(&rows, &trend::COLUMNS, &mut *snapshot).await?;
        drop(snapshot);
        for row in &rows {
            trend.push(row, &layouts)?;
        }
        trend.fill();
        let Some((last_start, last_id)) = trend.start_time.last().zip(trend.segment_id.last()) else {
            return Ok(false);
        };
        let kept = sqlx::query(
            "INSERT INTO trend_blocks (channel_no, number, format, revision, last_start_ns, last_segment_id, columns)
             VALUES ($1, $2, $3, $4, $5, $6, $7)
             ON CONFLICT (channel_no, number) DO UPDATE SET format = excluded.format, revision = excluded.revision,
                last_start_ns = excluded.last_start_ns, last_segment_id = excluded.last_segment_id, columns = excluded.columns
             WHERE trend_blocks.revision <= excluded.revision",
        )
        .bind(channel.channel_no)
        .bind(number)
        .bind(FORMAT)
        .bind(channel.revision)
        .bind(to_ns(*last_start)?)
        .bind(last_id.0.as_str())
        .bind(Block::of(&trend)?.encode_to_vec())
        .execute(self.write())
        .await?;
        Ok(kept.rows_affected() > 0)
    }
}
