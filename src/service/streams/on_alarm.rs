//! What is kept of streams when an alarm is raised.

use std::collections::HashMap;
use std::sync::Arc;

use jiff::SignedDuration;
use tokio::sync::broadcast::error::RecvError;

use super::Streams;
use super::cutting::Cutting;
use super::stored::StoredStream;
use crate::asset::AssetId;
use crate::estimate::{AlarmState, Severity};
use crate::service::error::ServiceError;
use crate::service::events::LiveEvent;
use crate::service::workers::blocking;
use crate::store::AlarmNotice;

/// An alarm that is raised by a record this much older than the stream says nothing of what comes now.
const OLD: SignedDuration = SignedDuration::from_hours(1);

/// Severities that alarms were raised with, to tell what is worse than before.
#[derive(Debug, Default)]
struct Raised(HashMap<String, Severity>);

impl Raised {
    /// Whether an alarm is raised by this, or got worse.
    fn is_news(&mut self, notice: &AlarmNotice) -> bool {
        let Some(severity) = notice.change.severity else {
            self.0.remove(&notice.alarm.id);
            return false;
        };
        let before = self.0.insert(notice.alarm.id.clone(), severity);
        notice.change.state == AlarmState::Unacknowledged
            && notice.change.action.as_ref().is_none_or(|action| action.automatic_reading().is_some())
            && before.is_none_or(|before| severity > before)
    }
}

impl Streams {
    /// Follows alarms for as long as the service is there.
    pub(super) fn follow_alarms_in_background(self: &Arc<Self>) {
        let (mut events, mut over) = (self.events.follow(), self.follow_end());
        let streams = Arc::downgrade(self);
        tokio::spawn(async move {
            let mut raised = Raised::default();
            loop {
                let event = tokio::select! {
                    _ = over.wait_for(|over| *over) => return,
                    event = events.recv() => event,
                };
                let notice = match event {
                    Ok(LiveEvent::AlarmChanged(notice)) => notice,
                    Ok(_) | Err(RecvError::Lagged(_)) => continue,
                    Err(RecvError::Closed) => return,
                };
                let Some(streams) = streams.upgrade() else { return };
                if raised.is_news(&notice)
                    && let Err(error) = streams.keep_around_alarm(&notice.alarm.asset_id, &notice).await
                {
                    let asset = &notice.alarm.asset_id;
                    tracing::warn!(%asset, %error, "failed to keep what is around an alarm");
                }
            }
        });
    }

    /// Keeps what is around an alarm of every stream of its asset.
    async fn keep_around_alarm(
        self: &Arc<Self>,
        asset: &AssetId,
        notice: &AlarmNotice,
    ) -> Result<(), ServiceError> {
        let streams = self.of_asset(asset);
        if streams.is_empty() {
            return Ok(());
        }
        let spec = Arc::new(self.store.asset(asset).await?.spec);
        if spec.stream.on_alarm.is_none() {
            return Ok(());
        }
        let raised_at = notice.change.time;
        for stream in streams {
            let (keeper, spec) = (Arc::clone(&stream), Arc::clone(&spec));
            let keep = move |stored: &mut StoredStream| {
                let state = stored.state();
                let time = state.next.and_then(|next| state.time(next));
                if time.is_none_or(|time| time.duration_since(raised_at) > OLD) {
                    return Ok(false);
                }
                let cutting = Cutting::of(&spec, &state.format)?;
                stored.keep_around_alarm(&cutting)
            };
            match blocking("keep what is around an alarm", move || keeper.with_stored(keep)).await? {
                Ok(true) => self.cut_in_background(&stream),
                // One of an asset of that name that is gone, too.
                Ok(false) | Err(ServiceError::StreamUnknown { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}
