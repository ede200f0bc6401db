//! Raw recordings within their quotas.
//!
//! What is derived from a record stays when its raw bytes are given up; they are given up only after it is
//! stored, since an object is counted in the transaction that stores the results of its record.

use std::sync::Arc;

use super::objects::RawObjects;
use crate::asset::AssetId;
use crate::service::error::ServiceError;
use crate::service::limits::RawQuotas;
use crate::store::{GivenUp, Store};

/// Objects given up in one transaction.
const GIVEN_UP_AT_ONCE: u32 = 256;

/// Gives up the oldest raw recordings over the quotas.
pub(crate) struct Retention {
    store: Store,
    objects: Arc<RawObjects>,
    quotas: RawQuotas,
    turn: tokio::sync::Mutex<()>,
}

impl Retention {
    pub(crate) fn new(store: Store, objects: Arc<RawObjects>, quotas: RawQuotas) -> Self {
        Self { store, objects, quotas, turn: tokio::sync::Mutex::default() }
    }

    /// Gives up the oldest raw recordings where there are more than the quotas allow, in the background.
    pub(crate) fn apply_in_background(self: &Arc<Self>) {
        if self.quotas == RawQuotas::default() {
            return;
        }
        let retention = Arc::clone(self);
        tokio::spawn(async move {
            // One at a time; one that waits sees what those before it have done.
            let Ok(_turn) = retention.turn.try_lock() else {
                return;
            };
            if let Err(error) = retention.apply().await {
                tracing::warn!(%error, "failed to give up raw recordings over their quota");
            }
        });
    }

    async fn apply(&self) -> Result<(), ServiceError> {
        if self.store.check_marks().await?.is_some() {
            return Ok(());
        }
        if let Some(quota) = self.quotas.bytes_per_asset {
            for (asset, bytes) in self.store.raw_volumes().await? {
                let Ok(asset) = AssetId::new(asset) else { continue };
                if bytes > quota {
                    self.give_up(Some(&asset), quota).await?;
                }
            }
        }
        if let Some(quota) = self.quotas.bytes {
            let bytes: u64 = self.store.raw_volumes().await?.values().sum();
            if bytes > quota {
                self.give_up(None, quota).await?;
            }
        }
        Ok(())
    }

    async fn give_up(&self, asset: Option<&AssetId>, quota: u64) -> Result<(), ServiceError> {
        loop {
            let _exclusive = self.objects.exclusive().await;
            let given_up = self.store.give_up_oldest(asset, quota, GIVEN_UP_AT_ONCE).await?;
            let GivenUp { objects, bytes, is_within, orphans } = given_up;
            if objects > 0 {
                self.objects.remove(orphans).await?;
                let of = asset.map_or("all", AssetId::as_str);
                tracing::info!(of, objects, bytes, "gave up the oldest raw recordings for the quota");
            }
            if is_within || objects == 0 {
                return Ok(());
            }
        }
    }
}
