//! Retention: deletes the oldest raw recordings that exceed the quotas.
//!
//! The results of a record are kept when its raw bytes are deleted. They are deleted only after the results
//! are stored, because an object is counted in the transaction that stores the results of its record.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use tokio::sync::Mutex;

use super::objects::{RawObjects, WaitingObjects};
use crate::asset::AssetId;
use crate::service::error::ServiceError;
use crate::service::limits::RawQuotas;
use crate::store::{DeletedRaw, Store};

/// Objects deleted in one transaction.
const DELETION_BATCH: u32 = 256;

/// Deletes the oldest raw recordings that exceed the quotas.
pub(crate) struct Retention {
    store: Store,
    objects: Arc<RawObjects>,
    quotas: RawQuotas,
    /// Held while the quotas are applied.
    enforcing: Mutex<()>,
    /// Whether something was committed since the quotas were last applied.
    is_due: AtomicBool,
}

impl Retention {
    pub(crate) fn new(store: Store, objects: Arc<RawObjects>, quotas: RawQuotas) -> Self {
        Self { store, objects, quotas, enforcing: Mutex::default(), is_due: AtomicBool::default() }
    }

    /// Applies the quotas in the background.
    pub(crate) fn apply_in_background(self: &Arc<Self>) {
        if self.quotas == RawQuotas::default() {
            return;
        }
        self.is_due.store(true, Ordering::SeqCst);
        let retention = Arc::clone(self);
        tokio::spawn(async move {
            // One application at a time, which then looks for what was committed meanwhile.
            while retention.is_due.load(Ordering::SeqCst) {
                let Ok(_guard) = retention.enforcing.try_lock() else {
                    return;
                };
                retention.is_due.store(false, Ordering::SeqCst);
                if let Err(error) = retention.apply().await {
                    tracing::warn!(%error, "failed to apply the quotas of raw recordings");
                }
            }
        });
    }

    async fn apply(&self) -> Result<(), ServiceError> {
        if self.store.check_marks().await?.is_some() {
            return Ok(());
        }
        let waiting = WaitingObjects::new();
        if let Some(quota) = self.quotas.bytes_per_asset {
            for (asset, bytes) in self.store.raw_volumes().await? {
                let Ok(asset) = AssetId::new(asset) else { continue };
                if bytes > quota {
                    self.enforce(Some(&asset), quota, &waiting).await?;
                }
            }
        }
        if let Some(quota) = self.quotas.bytes {
            let bytes: u64 = self.store.raw_volumes().await?.values().sum();
            if bytes > quota {
                self.enforce(None, quota, &waiting).await?;
            }
        }
        Ok(())
    }

    async fn enforce(
        &self,
        asset: Option<&AssetId>,
        quota: u64,
        waiting: &WaitingObjects,
    ) -> Result<(), ServiceError> {
        loop {
            let deleted = self.store.delete_oldest_raw(asset, quota, DELETION_BATCH).await?;
            let DeletedRaw { objects, bytes, is_within, orphans } = deleted;
            if objects > 0 {
                self.objects.remove(orphans, waiting).await?;
                let of = asset.map_or("all", AssetId::as_str);
                tracing::info!(
                    of,
                    objects,
                    bytes,
                    "deleted the oldest raw recordings to stay within the quota"
                );
            }
            if is_within || objects == 0 {
                return Ok(());
            }
        }
    }
}
