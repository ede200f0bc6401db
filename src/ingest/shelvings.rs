//! Shelvings that run out: told in the alarm's history and to those who follow it, also where no record comes.

use std::sync::Arc;
use std::time::Duration;

use super::{Ingest, IngestError, PersonsAction};
use crate::estimate::AlarmAction;

/// How often shelvings are looked at.
const LOOKED_AT_EVERY: Duration = Duration::from_secs(1);

/// Shelvings ended at a time.
const ENDED_AT_ONCE: u32 = 64;

impl Ingest {
    /// Ends shelvings as their time comes, in the background, as long as somebody holds the service.
    pub(super) fn end_shelvings_in_background(&self) {
        let held = Arc::downgrade(&self.inner);
        tokio::spawn(async move {
            loop {
                tokio::time::sleep(LOOKED_AT_EVERY).await;
                let Some(inner) = held.upgrade() else { return };
                let ingest = Self { inner };
                if ingest.is_ending() {
                    return;
                }
                if let Err(error) = ingest.end_shelvings().await {
                    tracing::warn!(%error, "shelvings that are over not told");
                }
            }
        });
    }

    async fn end_shelvings(&self) -> Result<(), IngestError> {
        let now = self.inner.clock.now();
        for alarm in self.inner.store.ended_shelvings(now, ENDED_AT_ONCE).await? {
            let over = PersonsAction {
                action: AlarmAction::ShelvingOver,
                by: String::new(),
                comment: String::new(),
            };
            match self.act_on_alarm(&alarm, over).await {
                // Somebody was faster: it is taken up again, shelved anew or gone.
                Ok(_) | Err(IngestError::Alarm(_) | IngestError::AlarmUnknown(_)) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}
