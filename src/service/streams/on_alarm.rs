//! Captures of stream samples around an alarm when it is raised.

use std::collections::{HashMap, HashSet};
use std::sync::{Arc, PoisonError};

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
use crate::store::{AlarmNotice, StoredAlarm};

/// Maximum age, relative to the stream, of the record that raised an alarm: an older one is unrelated to the
/// current samples.
const MAX_ALARM_AGE: SignedDuration = SignedDuration::from_hours(1);

/// The severities of raised alarms, to detect increases.
#[derive(Debug, Default)]
struct RaisedSeverities(HashMap<String, Severity>);

impl RaisedSeverities {
    /// Whether a notice raises an alarm or increases its severity.
    fn is_news(&mut self, notice: &AlarmNotice) -> bool {
        let AlarmNotice { alarm, change } = notice;
        // The last change of an alarm without a rule was another one.
        let Some(severity) = change.severity.filter(|_| alarm.rule.is_some()) else {
            self.0.remove(&alarm.id);
            return false;
        };
        let before = self.0.insert(alarm.id.clone(), severity);
        // A danger before this process started can only have eased to a warning.
        let is_first = || {
            severity == Severity::Danger || alarm.alarm.raised_at().is_none_or(|raised| raised == change.time)
        };
        change.state == AlarmState::Unacknowledged
            && change.action.as_ref().is_none_or(|action| action.automatic_reading().is_some())
            && before.map_or_else(is_first, |before| severity > before)
    }

    /// Takes the open alarms as those that are raised, after notices were lost; returns those that are news.
    fn news_among(&mut self, open: Vec<StoredAlarm>) -> Vec<AlarmNotice> {
        self.0.retain(|id, _| open.iter().any(|alarm| alarm.id == *id));
        let last = |alarm: StoredAlarm| Some(AlarmNotice { change: alarm.alarm.last()?.clone(), alarm });
        open.into_iter().filter_map(last).filter(|notice| self.is_news(notice)).collect()
    }
}

impl Streams {
    /// Handles an event that arrived from another process of a cluster.
    pub(crate) fn handle_event(&self, event: &LiveEvent) {
        match event {
            LiveEvent::AlarmChanged(_) | LiveEvent::Lost(_) => self.events.send(event.clone()),
            LiveEvent::AssetRemoved(asset) => self.forget(asset),
            _ => {}
        }
    }

    /// Follows alarms in the background for as long as the service exists.
    pub(super) fn watch_alarms_in_background(self: &Arc<Self>) {
        let (mut events, mut over) = (self.events.subscribe_to_alarms(), self.watch_end());
        let streams = Arc::downgrade(self);
        tokio::spawn(async move {
            let mut raised = RaisedSeverities::default();
            loop {
                let event = tokio::select! {
                    _ = over.wait_for(|over| *over) => return,
                    event = events.recv() => event,
                };
                let Some(streams) = streams.upgrade() else { return };
                let news = match event {
                    Ok(LiveEvent::AlarmChanged(notice)) if raised.is_news(&notice) => vec![*notice],
                    Ok(LiveEvent::Lost(count)) | Err(RecvError::Lagged(count)) => {
                        tracing::warn!(count, "lost notices of alarms; reading the open alarms instead");
                        let open = streams.open_alarms().await.inspect_err(
                            |error| tracing::warn!(%error, "failed to read the open alarms; samples around them may not be captured"),
                        );
                        open.map_or_else(|_| Vec::new(), |open| raised.news_among(open))
                    }
                    Ok(_) => Vec::new(),
                    Err(RecvError::Closed) => return,
                };
                for notice in news {
                    let asset = &notice.alarm.asset_id;
                    if let Err(error) = streams.capture_around_alarm(asset, &notice).await {
                        tracing::warn!(%asset, %error, "failed to capture samples around an alarm");
                    }
                }
            }
        });
    }

    /// The open alarms of the assets that have streams in this process.
    async fn open_alarms(&self) -> Result<Vec<StoredAlarm>, ServiceError> {
        let assets: HashSet<AssetId> = {
            let all = self.all.lock().unwrap_or_else(PoisonError::into_inner);
            all.keys().map(|(asset, _)| asset.clone()).collect()
        };
        Ok(self.store.open_alarms(&assets.iter().collect::<Vec<_>>()).await?)
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

#[cfg(test)]
mod tests {
    use jiff::Timestamp;

    use super::*;
    use crate::estimate::{Alarm, AlarmQuantity, AlarmReading, AlarmRule, AlarmSettings};
    use crate::service::events::EventSender;

    /// The notices of an alarm with these readings, one a second.
    fn notices(readings: &[f64]) -> Vec<AlarmNotice> {
        let settings = AlarmSettings { raise: 1, raise_of: 1, clear: 1, clear_of: 1 };
        let rule = AlarmRule {
            warning: Some(1.0),
            danger: Some(2.0),
            settings,
            ..AlarmRule::of(AlarmQuantity::Novelty)
        };
        let mut alarm = Alarm::default();
        let notice = |(second, value): (i64, &f64)| {
            let time = Timestamp::from_second(second).unwrap();
            let change = alarm.reading(&rule, AlarmReading { time, value: Some(*value) })?;
            let stored = StoredAlarm {
                id: "a".to_owned(),
                asset_id: AssetId::new("pump").unwrap(),
                channel: "1".to_owned(),
                quantity: rule.quantity.clone(),
                rule: Some(rule.clone()),
                alarm: alarm.clone(),
                changed_at: time,
            };
            Some(AlarmNotice { alarm: stored, change })
        };
        (0..).zip(readings).filter_map(notice).collect()
    }

    #[test]
    fn only_a_raised_or_worsened_alarm_is_news() {
        // Warning, danger, warning, cleared, danger, warning.
        let notices = notices(&[1.5, 2.5, 1.5, 0.5, 2.5, 1.5]);
        let expected = [true, true, false, false, true, false];
        let mut raised = RaisedSeverities::default();
        for (n, (notice, expected)) in notices.iter().zip(expected).enumerate() {
            assert_eq!(raised.is_news(notice), expected, "{n}");
            // The first notice after a start.
            assert_eq!(RaisedSeverities::default().is_news(notice), expected, "{n}");
            let mut without_rule = notice.clone();
            without_rule.alarm.rule = None;
            assert!(!RaisedSeverities::default().is_news(&without_rule), "{n}");
        }
        assert_eq!(notices.len(), expected.len());
    }

    #[test]
    fn after_a_loss_the_open_alarms_tell_what_is_news() {
        let notices = notices(&[1.5, 2.5, 1.5, 0.5, 2.5]);
        let open = |n: usize| vec![notices[n].alarm.clone()];
        let mut raised = RaisedSeverities::default();
        assert!(raised.is_news(&notices[0]));
        // The increase was lost; later the alarm is still the same.
        assert_eq!(raised.news_among(open(1)), [notices[1].clone()]);
        assert_eq!(raised.news_among(open(1)), []);
        // The end was lost, then the alarm is raised again.
        assert_eq!(raised.news_among(Vec::new()), []);
        assert!(raised.is_news(&notices[4]));
    }

    #[test]
    fn events_of_records_do_not_displace_alarms() {
        let sender = EventSender::default();
        let mut alarms = sender.subscribe_to_alarms();
        let notices = notices(&[1.5]);
        sender.send_alarms(notices.clone());
        for _ in 0..5000 {
            sender.send(LiveEvent::AssetChanged(AssetId::new("pump").unwrap()));
        }
        assert_eq!(alarms.try_recv(), Ok(LiveEvent::AlarmChanged(Box::new(notices[0].clone()))));
        assert!(alarms.try_recv().is_err());
    }
}
