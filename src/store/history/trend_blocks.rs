//! Blocks of a long history stored as columns, in addition to its rows, so that a history that is not in
//! memory can be read quickly.

use bytes::Bytes;
use futures_util::TryStreamExt;
use prost::Message;

use super::trend::{self, Trend, WearPoint, rows_after};
use crate::asset::SegmentId;
use crate::estimate::WearStatus;
use crate::store::assets::channel_of;
use crate::store::database::rows::{from_json, from_ns, get, get_count, to_json, to_ns};
use crate::store::database::watched::WatchedTransaction;
use crate::store::{ChannelSummary, SegmentKey, Store, StoreError};

/// Number of records in a block.
pub(in crate::store) const RECORDS: usize = 256;

/// Version of the block format; incremented with every change of it.
const FORMAT: i64 = 2;

/// Maximum number of channels in one round.
const MAX_CHANNELS: i64 = 100;

/// The columns of a block. Numbers and texts are bytes, which are copied at once.
#[derive(Clone, PartialEq, Message)]
struct Block {
    /// Nanoseconds as 64-bit integers.
    #[prost(bytes = "bytes", tag = "1")]
    start_time_ns: Bytes,
    #[prost(message, required, tag = "2")]
    segment_id: Texts,
    #[prost(string, tag = "3")]
    unit: String,
    #[prost(message, repeated, tag = "4")]
    indicators: Vec<Column>,
    #[prost(bytes = "bytes", tag = "5")]
    shaft_speed_hz: Bytes,
    #[prost(bytes = "bytes", tag = "6")]
    torque_nm: Bytes,
    #[prost(message, required, tag = "7")]
    status: Texts,
    #[prost(message, required, tag = "8")]
    reason: Texts,
    /// The numbers of [`numbers_of`], record after record; NaN for a missing number.
    #[prost(bytes = "bytes", tag = "9")]
    wear: Bytes,
}

/// An indicator's values.
#[derive(Clone, PartialEq, Message)]
struct Column {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(bytes = "bytes", tag = "2")]
    values: Bytes,
}

/// Texts one after the other.
#[derive(Clone, PartialEq, Message)]
struct Texts {
    #[prost(string, tag = "1")]
    all: String,
    #[prost(uint32, repeated, tag = "2")]
    lengths: Vec<u32>,
}

impl Texts {
    fn push(&mut self, text: &str) {
        self.lengths.push(text.len() as u32);
        self.all.push_str(text);
    }

    /// The texts; `None` instead of those that do not fit into `all`.
    fn iter(&self) -> impl Iterator<Item = Option<&str>> {
        let mut start = 0;
        self.lengths.iter().map(move |length| {
            let end = start + *length as usize;
            self.all.get(std::mem::replace(&mut start, end)..end)
        })
    }

    /// Whether there is one for each record.
    fn is_whole(&self) -> bool {
        self.lengths.len() == RECORDS && self.iter().all(|text| text.is_some())
    }
}

impl<'a> FromIterator<&'a str> for Texts {
    fn from_iter<I: IntoIterator<Item = &'a str>>(texts: I) -> Self {
        let mut all = Self::default();
        texts.into_iter().for_each(|text| all.push(text));
        all
    }
}

/// The bytes of a column of numbers.
fn bytes_of(numbers: impl IntoIterator<Item = f64>) -> Bytes {
    numbers.into_iter().flat_map(f64::to_le_bytes).collect()
}

/// The numbers of a column.
fn numbers_in(bytes: &[u8]) -> impl ExactSizeIterator<Item = f64> {
    bytes.as_chunks().0.iter().map(|number| f64::from_le_bytes(*number))
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
        let column = |(name, values): (&String, &Vec<f64>)| Column {
            name: name.clone(),
            values: bytes_of(values.iter().copied()),
        };
        let mut start_time_ns = Vec::new();
        for time in &trend.start_time {
            start_time_ns.extend(to_ns(*time)?.to_le_bytes());
        }
        let mut status = Texts::default();
        for wear in &trend.wear {
            status.push(to_json(&wear.status, "status", "a history")?.trim_matches('"'));
        }
        let wear = trend.wear.iter().flat_map(numbers_of).map(|number| number.unwrap_or(f64::NAN));
        Ok(Self {
            start_time_ns: start_time_ns.into(),
            segment_id: trend.segment_id.iter().map(|id| id.0.as_str()).collect(),
            unit: trend.unit.clone(),
            indicators: trend.indicators.iter().map(column).collect(),
            shaft_speed_hz: bytes_of(trend.shaft_speed_hz.iter().copied()),
            torque_nm: bytes_of(trend.torque_nm.iter().copied()),
            status,
            reason: trend.wear.iter().map(|wear| &*wear.reason).collect(),
            wear: bytes_of(wear),
        })
    }

    /// Whether all columns have the right length.
    fn is_whole(&self) -> bool {
        let columns = [&self.start_time_ns, &self.shaft_speed_hz, &self.torque_nm];
        let mut columns = columns.into_iter().chain(self.indicators.iter().map(|column| &column.values));
        columns.all(|column| column.len() == RECORDS * size_of::<f64>())
            && self.wear.len() == RECORDS * NUMBERS * size_of::<f64>()
            && [&self.segment_id, &self.status, &self.reason].into_iter().all(Texts::is_whole)
    }

    /// Appends a whole block to a history that has room for `records` in all.
    fn append_to(self, trend: &mut Trend, records: usize) -> Result<(), StoreError> {
        let position = trend.len();
        for Column { name, values } in self.indicators {
            let column = trend.indicators.entry(name).or_insert_with(|| Vec::with_capacity(records));
            column.resize(position, f64::NAN);
            column.extend(numbers_in(&values));
        }
        // Most records have the status of the one before.
        let mut last: Option<(&str, WearStatus)> = None;
        let numbers = self.wear.as_chunks::<{ NUMBERS * size_of::<f64>() }>().0;
        for ((text, reason), numbers) in self.status.iter().zip(self.reason.iter()).zip(numbers) {
            let text = text.unwrap_or_default();
            let status = match last {
                Some((same, status)) if same == text => status,
                _ => from_json(&format!("\"{text}\""), "status", "a history")?,
            };
            last = Some((text, status));
            let mut numbers =
                numbers_in(numbers).map(|number| Some(number).filter(|number| !number.is_nan()));
            let mut number = || numbers.next().flatten();
            trend.wear.push(WearPoint {
                status,
                reason: reason.unwrap_or_default().into(),
                median_um: number(),
                mean_um: number(),
                low_um: number(),
                p25_um: number(),
                p75_um: number(),
                high_um: number(),
                log_evidence: number(),
                reference_wear_um: number(),
            });
        }
        trend.unit = self.unit;
        let times = self.start_time_ns.as_chunks().0.iter();
        trend.start_time.extend(times.map(|time| from_ns(i64::from_le_bytes(*time))));
        trend.segment_id.extend(self.segment_id.iter().flatten().map(|id| SegmentId(id.to_owned())));
        trend.shaft_speed_hz.extend(numbers_in(&self.shaft_speed_hz));
        trend.torque_nm.extend(numbers_in(&self.torque_nm));
        Ok(())
    }
}

/// Starts a history from its stored blocks.
pub(in crate::store) async fn load(
    snapshot: &mut WatchedTransaction,
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
    let records = usize::try_from(channel.segments).map_or(0, |records| records.min(trend::MAX_RECORDS));
    trend.reserve(records);
    let mut expected = 0;
    while let Some(row) = rows.try_next().await? {
        let number: i64 = get(&row, "number")?;
        // An unreadable block, and those after it, are read from the rows.
        let columns = Bytes::from(get::<Vec<u8>>(&row, "columns")?);
        let block = Block::decode(columns).ok().filter(Block::is_whole);
        let Some(block) = block.filter(|_| number == expected) else { break };
        block.append_to(trend, records)?;
        expected += 1;
    }
    Ok(())
}

impl Store {
    /// Stores the missing blocks of long histories.
    pub async fn store_trend_blocks(&self) -> Result<(), StoreError> {
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
        get_count(&row, "blocks")
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
        let layouts = self.layouts().load(&rows, &trend::COLUMNS, &mut *snapshot).await?;
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
        .execute(self.write()?)
        .await?;
        Ok(kept.rows_affected() > 0)
    }
}

#[cfg(test)]
mod tests {
    use jiff::Timestamp;

    use super::*;

    fn history() -> Trend {
        let numbers = || (0..RECORDS).map(|n| n as f64);
        let wear = |n: f64| WearPoint {
            status: if n < 20.0 { WearStatus::CollectingBaseline } else { WearStatus::Estimated },
            reason: format!("record {n}, in µm").into(),
            median_um: (n > 20.0).then_some(n),
            mean_um: None,
            low_um: None,
            p25_um: None,
            p75_um: None,
            high_um: Some(-n),
            reference_wear_um: None,
            log_evidence: Some(0.5 * n),
        };
        let mut trend = Trend::default();
        trend.indicators.insert("rms".to_owned(), numbers().collect());
        trend.unit = "g".to_owned();
        trend.start_time =
            (0..RECORDS as i64).map(|n| Timestamp::from_nanosecond(n.into()).unwrap()).collect();
        trend.segment_id = (0..RECORDS).map(|n| SegmentId(format!("{n:x}"))).collect();
        trend.shaft_speed_hz = numbers().map(|n| 10.0 + n).collect();
        trend.torque_nm = numbers().map(|n| 2.0 * n).collect();
        trend.wear = numbers().map(wear).collect();
        trend
    }

    fn stored(trend: &Trend) -> Block {
        Block::decode(Bytes::from(Block::of(trend).unwrap().encode_to_vec())).unwrap()
    }

    #[test]
    fn a_block_gives_back_its_part_of_a_history() {
        let trend = history();
        let block = stored(&trend);
        assert!(block.is_whole());
        let mut read = Trend::default();
        block.append_to(&mut read, RECORDS).unwrap();
        assert_eq!(format!("{read:?}"), format!("{trend:?}"));
    }

    #[test]
    fn a_block_with_texts_or_columns_cut_off_is_not_whole() {
        let whole = stored(&history());
        let mut longer = whole.clone();
        longer.reason.lengths[RECORDS - 1] += 1;
        let mut within_a_character = whole.clone();
        let micro = within_a_character.reason.all.find('µ').unwrap() as u32;
        within_a_character.reason.lengths[0] = micro + 1;
        let mut shorter = whole;
        shorter.torque_nm.truncate(7);
        for block in [longer, within_a_character, shorter] {
            assert!(!block.is_whole());
        }
    }
}
