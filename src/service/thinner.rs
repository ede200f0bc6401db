//! Thins the results of old records in the background.

use std::sync::Arc;
use std::time::Duration;

use jiff::SignedDuration;

use super::background::every;
use super::clock::Clock;
use super::error::ServiceError;
use super::limits::OldResults;
use crate::store::{Store, Thinning};

/// Time between two checks whether a round is due.
const CHECK_INTERVAL: Duration = Duration::from_secs(60);

/// Thins the results of old records.
pub(crate) struct Thinner {
    pub(crate) store: Store,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) old_results: OldResults,
}

impl Thinner {
    /// Looks once an hour, in the background, for channels that are due to be thinned; of several processes
    /// on a store, one does so.
    pub(crate) fn in_background(self) {
        let (store, thinner) = (self.store.clone(), Arc::new(self));
        every(CHECK_INTERVAL, Duration::ZERO, "thin the results of old records", &store, move || {
            let thinner = Arc::clone(&thinner);
            Some(async move { thinner.run_once().await })
        });
    }

    async fn run_once(&self) -> Result<(), ServiceError> {
        let now = self.store.now(self.clock.now()).await?;
        if !self.store.begin_thinning(now).await? {
            return Ok(());
        }
        let signed = |time: Duration| SignedDuration::try_from(time).unwrap_or(SignedDuration::MAX);
        let OldResults { age, interval } = self.old_results;
        let thinning = Thinning { now, age: signed(age), interval: signed(interval) };
        let removed = self.store.thin_results(thinning).await?;
        if removed > 0 {
            tracing::info!(records = removed, "thinned the results of old records");
        }
        Ok(())
    }
}
