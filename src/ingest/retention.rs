//! Raw recordings within their quotas, and objects that nothing refers to.
//!
//! What is derived from a record stays when its raw bytes are given up; they are given up only after it is stored, since an object
//! is counted in the transaction that stores the results of its record.

use super::{Ingest, IngestError};
use crate::asset::AssetId;
use crate::store::GivenUp;

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
                self.give_up(Some(&asset), bytes.saturating_sub(quota)).await?;
            }
        }
        if let Some(quota) = quotas.bytes {
            let bytes: u64 = store.raw_volumes().await?.values().sum();
            self.give_up(None, bytes.saturating_sub(quota)).await?;
        }
        Ok(())
    }

    async fn give_up(&self, asset: Option<&AssetId>, mut bytes: u64) -> Result<(), IngestError> {
        while bytes > 0 {
            // Nobody is between keeping raw bytes and storing their rows now.
            let _nobody_keeps = self.inner.keeping.write().await;
            let given_up = self.inner.store.give_up_oldest(asset, bytes, GIVEN_UP_AT_ONCE).await?;
            if given_up.objects == 0 {
                break;
            }
            let GivenUp {
                objects,
                bytes: freed,
                orphans,
            } = given_up;
            self.remove_objects(orphans).await?;
            let of = asset.map_or("all", AssetId::as_str);
            tracing::info!(of, objects, bytes = freed, "oldest raw recordings given up for the quota");
            bytes = bytes.saturating_sub(freed);
        }
        Ok(())
    }

    /// Removes raw objects that nothing refers to: what a process that was killed had kept and not stored the results of. Returns how
    /// many there were, and their bytes.
    pub async fn remove_orphans(&self) -> Result<(u64, u64), IngestError> {
        let (mut count, mut bytes) = (0, 0);
        for shard in 0..=u8::MAX {
            let store = self.inner.store.clone();
            let list = move || store.objects().list(shard);
            let listed = self.inner.workers.run("list raw objects", list).await??;
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

    pub(super) async fn remove_objects(&self, names: Vec<String>) -> Result<(), IngestError> {
        let store = self.inner.store.clone();
        let remove = move || names.iter().try_for_each(|name| store.objects().remove(name));
        Ok(self.inner.workers.run("remove raw recordings", remove).await??)
    }
}
