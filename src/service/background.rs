//! Work that is repeated in the background, and work under a lease.

use std::time::Duration;

use super::error::ServiceError;
use crate::store::Store;

/// Does `work`, and renews its lease at each interval until it is done, however long its steps take.
pub(crate) async fn while_leased<T, R: Future<Output = ()>>(
    interval: Duration,
    work: impl Future<Output = T>,
    renew: impl Fn() -> R,
) -> T {
    let renewals = async {
        loop {
            tokio::time::sleep(interval).await;
            renew().await;
        }
    };
    tokio::select! {
        done = work => done,
        never = renewals => never,
    }
}

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
                tracing::warn!(%error, "failed to {what}; retrying later");
            }
            tokio::time::sleep(interval).await;
        }
    });
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU32, Ordering};

    use super::*;

    #[tokio::test]
    async fn a_lease_is_renewed_during_a_long_step() {
        let renewals = AtomicU32::new(0);
        let renew = || async {
            renewals.fetch_add(1, Ordering::Relaxed);
        };
        let work = async {
            while renewals.load(Ordering::Relaxed) < 3 {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
            7
        };
        assert_eq!(while_leased(Duration::from_millis(10), work, renew).await, 7);
    }
}
