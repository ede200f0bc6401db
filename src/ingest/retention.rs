//! Raw recordings within their quotas, and objects that nothing refers to.
//!
//! What is derived from a record stays when its raw bytes are given up; they are given up only after it is stored, since an object
//! is counted in the transaction that stores the results of its record.
//!
//! Where other processes store as well, one of them may be between keeping an object and storing what refers to it, or a record may wait in a
//! queue for its results. Every keeping writes the object anew, so its age says since when nobody has brought it; one that nothing refers to
//! goes once it is older than anything waits.

use jiff::Timestamp;

use super::{Ingest, IngestError};
use crate::asset::AssetId;
use crate::store::{GivenUp, StoreError};

/// Objects given up in one transaction.
const GIVEN_UP_AT_ONCE: u32 = 256;

/// How many bytes of raw recordings are kept; no bound where not given.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RawQuotas {
    /// Of all assets together; an object that two assets have counts for both.
    pub bytes: Option<u64>,
    /// Of each asset.
    pub bytes_per_asset: Option<u64>,
}

impl Ingest {
    /// Gives up the oldest raw recordings where there are more than the quotas allow, in the background.
    pub(super) fn retain_in_background(&self) {
        if self.inner.quotas == RawQuotas::default() || self.is_entrance() {
            return;
        }
        let ingest = self.clone();
        tokio::spawn(async move {
            // One at a time; one that waits sees what those before it have done.
            let Ok(_turn) = ingest.inner.retaining.try_lock() else { return };
            if let Err(error) = ingest.retain().await {
                tracing::warn!(%error, "raw recordings over their quota not given up");
            }
        });
    }

    async fn retain(&self) -> Result<(), IngestError> {
        let store = &self.inner.store;
        let quotas = self.inner.quotas;
        if let Some(quota) = quotas.bytes_per_asset {
            for (asset, bytes) in store.raw_volumes().await? {
                let Ok(asset) = AssetId::new(asset) else { continue };
                if bytes > quota {
                    self.give_up(Some(&asset), quota).await?;
                }
            }
        }
        if let Some(quota) = quotas.bytes {
            let bytes: u64 = store.raw_volumes().await?.values().sum();
            if bytes > quota {
                self.give_up(None, quota).await?;
            }
        }
        Ok(())
    }

    async fn give_up(&self, asset: Option<&AssetId>, quota: u64) -> Result<(), IngestError> {
        loop {
            // Nobody is between keeping raw bytes and storing their rows now.
            let _nobody_keeps = self.inner.keeping.write().await;
            let given_up = self.inner.store.give_up_oldest(asset, quota, GIVEN_UP_AT_ONCE).await?;
            let GivenUp {
                objects,
                bytes,
                is_within,
                orphans,
            } = given_up;
            if objects > 0 {
                self.remove_objects(orphans).await?;
                let of = asset.map_or("all", AssetId::as_str);
                tracing::info!(of, objects, bytes, "oldest raw recordings given up for the quota");
            }
            if is_within || objects == 0 {
                return Ok(());
            }
        }
    }

    /// Removes raw objects that nothing refers to: what a process that was killed had kept and not stored the results of. Returns how
    /// many there were, and their bytes.
    pub async fn remove_orphans(&self) -> Result<(u64, u64), IngestError> {
        let (mut count, mut bytes) = (0, 0);
        for shard in 0..=u8::MAX {
            let store = self.inner.store.clone();
            let list = move || store.objects().list(shard);
            let mut listed = self.inner.workers.run("list raw objects", list).await??;
            listed.retain(|object| self.is_old_enough(object.written_at));
            let names = listed.iter().map(|object| object.name.clone()).collect();
            let suspects = self.inner.store.orphans_among(names).await?;
            if suspects.is_empty() {
                continue;
            }
            // What is being stored just now looks the same: nobody is between keeping and storing while this looks again.
            let _nobody_keeps = self.inner.keeping.write().await;
            let orphans = self.inner.store.orphans_among(suspects).await?;
            count += orphans.len() as u64;
            bytes += listed
                .iter()
                .filter(|object| orphans.contains(&object.name))
                .map(|object| object.bytes)
                .sum::<u64>();
            self.remove_objects(orphans).await?;
        }
        Ok((count, bytes))
    }

    /// Removes objects that nothing refers to; where other processes store as well, only those that none of them can have brought lately.
    pub(super) async fn remove_objects(&self, names: Vec<String>) -> Result<(), IngestError> {
        let ingest = self.clone();
        let remove = move || {
            let objects = ingest.inner.store.objects();
            for name in &names {
                // Asked again at the last moment: bringing an object again makes it new.
                if !ingest.inner.store.is_shared() || objects.written_at(name)?.is_some_and(|time| ingest.is_old_enough(time)) {
                    objects.remove(name)?;
                }
            }
            Ok::<_, StoreError>(())
        };
        Ok(self.inner.workers.run("remove raw recordings", remove).await??)
    }

    /// Whether an object of this time may go where nothing refers to it. What was answered and waits for its results is younger.
    fn is_old_enough(&self, written_at: Timestamp) -> bool {
        let age = self.inner.store.orphan_age();
        age.is_none_or(|age| age.is_zero() || self.inner.clock.now().duration_since(written_at) >= age)
    }
}
