//! Work that is repeated in the background.

use std::time::Duration;

use super::error::ServiceError;
use crate::store::Store;

/// Does `work` in the background after `first`, and again each `interval` after its end, until the store is
/// closed or `work` returns `None` because what it is for is gone. `what` completes the message "failed to".
pub(crate) fn every<F>(
    interval: Duration,
    first: Duration,
    what: &'static str,
    store: &Store,
    mut work: impl FnMut() -> Option<F> + Send + 'static,
) where
    F: Future<Output = Result<(), ServiceError>> + Send + 'static,
{
    let store = store.clone();
    tokio::spawn(async move {
        tokio::time::sleep(first).await;
        while !store.is_closed() {
            let Some(round) = work() else { return };
            if let Err(error) = round.await {
                tracing::warn!(%error, "failed to {what}: retrying later");
            }
            tokio::time::sleep(interval).await;
        }
    });
}
