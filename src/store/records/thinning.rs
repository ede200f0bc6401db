//! Thinning of old results: of the records that are older than some age, one in each interval is kept.

use jiff::{SignedDuration, Timestamp};
use sqlx::any::AnyRow;

use crate::asset::SegmentId;
use crate::store::assets::channel_of;
use crate::store::database::rows::{from_ns, get, to_ns};
use crate::store::transaction::Transaction;
use crate::store::{ChannelSummary, Store, StoreError};

/// Time between two rounds of thinning by any process.
const ROUND_INTERVAL: SignedDuration = SignedDuration::from_hours(1);

/// Channels read in one query.
const CHANNELS_PER_QUERY: usize = 500;

/// Records of a channel examined in one transaction.
const EXAMINED_PER_TRANSACTION: usize = 2048;

/// Parts of the age, one of which passes until a channel is thinned again: each time its stored trend is made
/// anew.
const STEPS_PER_AGE: i32 = 16;

/// Factor on the number of baseline records: as many records are kept after the start of a channel and after
/// each maintenance event, since some of them may not be usable.
const KEPT_PER_BASELINE_RECORD: i64 = 2;

/// Which results are thinned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Thinning {
    /// The current time.
    pub now: Timestamp,
    /// Minimum age at which results are thinned. It counts from the current time or from the channel's latest
    /// record, whichever is earlier: a clock that is ahead removes nothing.
    pub age: SignedDuration,
    /// Of the records in each interval of this length, the first is kept.
    pub interval: SignedDuration,
}

/// A record of a channel, in the order of time.
struct OldRecord {
    id: SegmentId,
    start_ns: i64,
    /// Whether its results are kept whatever its neighbours are.
    is_kept: bool,
    is_excluded: bool,
    has_raw: bool,
}

/// The parts of a channel's history whose records are all kept: each begins with the first record or with a
/// maintenance event.
struct KeptStarts {
    /// Start of each part, in the order of time.
    starts_ns: Vec<i64>,
    /// Number of records kept in each part.
    records: i64,
}

/// The time that is earlier by `by`, but not before 1970.
fn earlier(time: Timestamp, by: SignedDuration) -> Timestamp {
    time.checked_sub(by).map_or(Timestamp::UNIX_EPOCH, |time| time.max(Timestamp::UNIX_EPOCH))
}

impl Thinning {
    /// The time before which the records of a channel are old, whose latest record is at `latest`.
    fn before(&self, latest: Timestamp) -> Timestamp {
        earlier(latest.min(self.now), self.age)
    }

    /// A channel is due if it is thinned until an earlier time than this.
    fn due(&self, before: Timestamp) -> Timestamp {
        earlier(before, self.age / STEPS_PER_AGE)
    }
}

impl Store {
    /// Claims a round of thinning; returns false if a process made one within the last hour.
    pub async fn begin_thinning(&self, now: Timestamp) -> Result<bool, StoreError> {
        self.begin_round("thinned_at_ns", now, ROUND_INTERVAL).await
    }

    /// Removes old records that are not among those kept; returns their number.
    ///
    /// Kept are the first record of each interval, records with raw bytes and those after them, excluded
    /// records and those with a reference wear, the latest record, and those from which a baseline is made.
    /// The results that are kept stay as they were estimated from all records.
    pub async fn thin_results(&self, thinning: Thinning) -> Result<u64, StoreError> {
        let (mut removed, mut after) = (0, 0);
        loop {
            let rows = sqlx::query(
                "SELECT * FROM channels WHERE channel_no > $1 AND thinned_until_ns < $2 AND first_start_ns < $2
                 ORDER BY channel_no LIMIT $3",
            )
            .bind(after)
            .bind(to_ns(thinning.due(thinning.before(thinning.now)))?)
            .bind(CHANNELS_PER_QUERY as i64)
            .fetch_all(self.read())
            .await?;
            for row in &rows {
                let channel = channel_of(row)?;
                after = channel.channel_no;
                loop {
                    let (count, is_done) = self.thin_next(&channel, thinning).await?;
                    removed += count;
                    if is_done {
                        break;
                    }
                }
            }
            if rows.len() < CHANNELS_PER_QUERY {
                return Ok(removed);
            }
        }
    }

    /// Thins the next records of a channel; returns how many were removed, and whether the channel is done.
    async fn thin_next(
        &self,
        channel: &ChannelSummary,
        thinning: Thinning,
    ) -> Result<(u64, bool), StoreError> {
        let mut transaction = self.begin().await?;
        // Asset or channel may be deleted by now.
        let asset = match transaction.asset(&channel.asset_id).await {
            Err(StoreError::AssetUnknown(_)) => return Ok((0, true)),
            other => other?,
        };
        let mut channel = match transaction.lock_channel(channel).await {
            Err(StoreError::AssetUnknown(_)) => return Ok((0, true)),
            other => other?,
        };
        // What is being recomputed is thinned once that is done.
        if channel.must_fold || channel.next_wear.is_some() || channel.leftovers {
            return Ok((0, true));
        }
        let mut starts_ns = vec![i64::MIN];
        // Within the transaction: no event is added before its end.
        for event in transaction.maintenance(&channel.asset_id).await? {
            starts_ns.push(to_ns(event.time)?);
        }
        let records = KEPT_PER_BASELINE_RECORD * i64::from(asset.spec.baseline.records);
        let kept = KeptStarts { starts_ns, records };
        // The places of the records after the newest state follow from their number.
        let Some(folded) = transaction.last_folded_time(&channel).await? else {
            return Ok((0, true));
        };
        let before = thinning.before(channel.last_start_time.unwrap_or(Timestamp::UNIX_EPOCH)).min(folded);
        let (thinned_until_ns, first) = transaction.old_records(&channel, before, 1).await?;
        let is_due = thinned_until_ns < to_ns(thinning.due(before))?;
        // Mostly the earliest record that is left still has its raw bytes.
        if !is_due || first.iter().all(|record| record.has_raw) {
            return Ok((0, true));
        }
        let (_, old) = transaction.old_records(&channel, before, EXAMINED_PER_TRANSACTION).await?;
        let (removed, until_ns) =
            transaction.records_to_thin(&channel, thinned_until_ns, &old, &kept, thinning.interval).await?;
        transaction.delete_segments(removed.iter().map(|record| &record.id)).await?;
        sqlx::query("UPDATE channels SET thinned_until_ns = $2 WHERE channel_no = $1")
            .bind(channel.channel_no)
            .bind(until_ns)
            .execute(&mut *transaction.inner)
            .await?;
        if !removed.is_empty() {
            channel.segments -= removed.len() as u64;
            transaction.set_channel(&mut channel, true).await?;
        }
        let is_done = old.len() < EXAMINED_PER_TRANSACTION || until_ns == thinned_until_ns;
        let count = removed.len() as u64;
        transaction.commit().await?;
        Ok((count, is_done))
    }
}

impl Transaction {
    /// The time of the last record in the newest stored state of a channel's served history.
    async fn last_folded_time(&mut self, channel: &ChannelSummary) -> Result<Option<Timestamp>, StoreError> {
        let row = sqlx::query(
            "SELECT MAX(start_time_ns) AS start_ns FROM fold_states WHERE channel_no = $1 AND generation = $2",
        )
        .bind(channel.channel_no)
        .bind(channel.wear_generation)
        .fetch_one(&mut *self.inner)
        .await?;
        Ok(get::<Option<i64>>(&row, "start_ns")?.map(from_ns))
    }

    /// The time until which a channel is thinned, and up to `limit` of the next records.
    async fn old_records(
        &mut self,
        channel: &ChannelSummary,
        before: Timestamp,
        limit: usize,
    ) -> Result<(i64, Vec<OldRecord>), StoreError> {
        let row = sqlx::query("SELECT thinned_until_ns FROM channels WHERE channel_no = $1")
            .bind(channel.channel_no)
            .fetch_one(&mut *self.inner)
            .await?;
        let from_ns: i64 = get(&row, "thinned_until_ns")?;
        let rows = sqlx::query(
            "SELECT s.id, s.start_time_ns, s.reference_wear_um, s.excluded, r.sha256 FROM segments s
             LEFT JOIN raw_objects r ON r.sha256 = s.raw_sha256 AND r.asset_id = $2
             WHERE s.channel_no = $1 AND s.start_time_ns >= $3 AND s.start_time_ns < $4 ORDER BY s.start_time_ns, s.id LIMIT $5",
        )
        .bind(channel.channel_no)
        .bind(channel.asset_id.as_str())
        .bind(from_ns)
        .bind(to_ns(before)?)
        .bind(limit as i64)
        .fetch_all(&mut *self.inner)
        .await?;
        let last = channel.last_segment.as_ref();
        let old = rows.iter().map(|row: &AnyRow| {
            let id = SegmentId(get(row, "id")?);
            Ok(OldRecord {
                is_kept: get::<Option<f64>>(row, "reference_wear_um")?.is_some() || last == Some(&id),
                is_excluded: get::<i64>(row, "excluded")? != 0,
                has_raw: get::<Option<String>>(row, "sha256")?.is_some(),
                start_ns: get(row, "start_time_ns")?,
                id,
            })
        });
        Ok((from_ns, old.collect::<Result<_, StoreError>>()?))
    }

    /// The records to be removed, and the time until which the channel is thinned then.
    async fn records_to_thin<'a>(
        &mut self,
        channel: &ChannelSummary,
        from_ns: i64,
        old: &'a [OldRecord],
        kept: &KeptStarts,
        interval: SignedDuration,
    ) -> Result<(Vec<&'a OldRecord>, i64), StoreError> {
        let interval_ns = i64::try_from(interval.as_nanos()).unwrap_or(i64::MAX).max(1);
        let before = sqlx::query(
            "SELECT MAX(start_time_ns) AS last_ns FROM segments WHERE channel_no = $1 AND start_time_ns < $2",
        )
        .bind(channel.channel_no)
        .bind(from_ns)
        .fetch_one(&mut *self.inner)
        .await?;
        let mut interval = get::<Option<i64>>(&before, "last_ns")?.map(|ns| ns.div_euclid(interval_ns));
        // Records of the current part up to the first of `old`.
        let part = kept.starts_ns.partition_point(|start| *start <= from_ns).saturating_sub(1);
        let (mut part, mut count) =
            (part, self.count_between(channel, kept, kept.starts_ns[part], from_ns).await?);
        let mut removed = Vec::new();
        for record in old {
            if record.has_raw {
                return Ok((removed, record.start_ns));
            }
            while kept.starts_ns.get(part + 1).is_some_and(|start| *start <= record.start_ns) {
                (part, count) = (part + 1, 0);
            }
            count += 1;
            let own = Some(record.start_ns.div_euclid(interval_ns));
            if record.is_excluded {
                continue;
            }
            if own == interval && !record.is_kept && count > kept.records {
                removed.push(record);
            }
            interval = own;
        }
        // Records of the same time as the last one may follow it.
        Ok((removed, old.last().map_or(from_ns, |last| last.start_ns)))
    }

    /// Number of a channel's records from `start_ns` on and before `end_ns`, at most that of the kept ones.
    async fn count_between(
        &mut self,
        channel: &ChannelSummary,
        kept: &KeptStarts,
        start_ns: i64,
        end_ns: i64,
    ) -> Result<i64, StoreError> {
        let row = sqlx::query(
            "SELECT COUNT(*) AS records FROM (
                SELECT id FROM segments WHERE channel_no = $1 AND start_time_ns >= $2 AND start_time_ns < $3 LIMIT $4
             ) AS first",
        )
        .bind(channel.channel_no)
        .bind(start_ns)
        .bind(end_ns)
        .bind(kept.records)
        .fetch_one(&mut *self.inner)
        .await?;
        get(&row, "records")
    }
}
