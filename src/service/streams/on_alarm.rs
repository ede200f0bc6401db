//! Captures of stream samples around an alarm when it is raised.

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

/// Maximum age, relative to the stream, of the record that raised an alarm: an older one is unrelated to the
/// current samples.
const MAX_ALARM_AGE: SignedDuration = SignedDuration::from_hours(1);

/// The severities of raised alarms, to detect increases.
#[derive(Debug, Default)]
struct RaisedSeverities(HashMap<String, Severity>);

impl RaisedSeverities {
    /// Whether a notice raises an alarm or increases its severity.
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
    /// Notes an event that arrived from another process of a cluster.
    pub(crate) fn note_event(&self, event: &LiveEvent) {
        match event {
            LiveEvent::AlarmChanged(_) => self.events.announce(event.clone()),
            LiveEvent::AssetRemoved(asset) => self.forget(asset),
            _ => {}
        }
    }

    /// Follows alarms in the background for as long as the service exists.
    pub(super) fn follow_alarms_in_background(self: &Arc<Self>) {
        let (mut events, mut over) = (self.events.follow(), self.follow_end());
        let streams = Arc::downgrade(self);
        tokio::spawn(async move {
            let mut raised = RaisedSeverities::default();
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
                    && let Err(error) = streams.capture_around_alarm(&notice.alarm.asset_id, &notice).await
                {
                    let asset = &notice.alarm.asset_id;
                    tracing::warn!(%asset, %error, "failed to capture samples around an alarm");
                }
            }
        });
    }

    /// Captures the samples around an alarm in every stream of its asset.
    async fn capture_around_alarm(
        self: &Arc<Self>,
        asset: &AssetId,
        notice: &AlarmNotice,
    ) -> Result<(), ServiceError> {
        let streams = self.of_asset(asset).await?;
        if streams.is_empty() {
            return Ok(());
        }
        let spec = Arc::new(self.store.asset(asset).await?.spec);
        if spec.stream.on_alarm.is_none() {
            return Ok(());
        }
        let raised_at = notice.change.time;
        // Other processes of a cluster receive the same notice.
        let alarm: Arc<str> = format!("{} {raised_at}", notice.alarm.id).into();
        for stream in streams {
            let (capturing, spec, alarm) = (Arc::clone(&stream), Arc::clone(&spec), Arc::clone(&alarm));
            let capture = move |stored: &mut StoredStream| {
                let state = stored.state();
                let time = state.next.and_then(|next| state.time(next));
                if time.is_none_or(|time| time.duration_since(raised_at) > MAX_ALARM_AGE) {
                    return Ok(false);
                }
                let cutting = Cutting::of(&spec, &state.format)?;
                stored.capture_around_alarm(&alarm, &cutting)
            };
            match blocking("capture samples around an alarm", move || capturing.with_stored(capture)).await? {
                Ok(true) => self.cut_in_background(&stream),
                // Also the stream of a deleted asset of the same name.
                Ok(false) | Err(ServiceError::StreamUnknown { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}
