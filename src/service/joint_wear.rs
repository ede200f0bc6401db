//! The joint wear estimate of an asset's channels, from the records of those that are not silent.

use jiff::Timestamp;

use crate::asset::Segment;
use crate::estimate::{AlarmReading, ChannelContribution, JointEstimate, RecordTimes, WearEstimate};
use crate::store::{Asset, ChannelSummary, Order, SegmentFilter, Store, StoreError};

/// The joint wear estimate of an asset.
pub struct JointWear {
    /// The channel that contributes most.
    pub leading: ChannelSummary,
    /// Its latest record that is not excluded.
    pub segment: Segment,
    /// The joint estimate.
    pub wear: WearEstimate,
    /// The contribution of each channel; empty if there is only one.
    pub contributions: Vec<ChannelContribution>,
}

impl JointWear {
    /// The channels that contribute to an asset's estimate: only the one named by its description, else all.
    pub fn contributing_channels<'a>(
        asset: &Asset,
        channels: &'a [ChannelSummary],
    ) -> Vec<&'a ChannelSummary> {
        let named = asset.spec.sensor.channel.as_deref();
        let named = named.and_then(|name| channels.iter().find(|channel| channel.channel == name));
        named.map_or_else(|| channels.iter().collect(), |named| vec![named])
    }

    /// Computes the joint estimate of these channels; returns `None` without records.
    pub async fn load(store: &Store, channels: &[&ChannelSummary]) -> Result<Option<Self>, StoreError> {
        let mut latest = Vec::with_capacity(channels.len());
        for channel in channels {
            if let Some(segment) = store.latest_counted(channel).await? {
                latest.push((*channel, segment));
            }
        }
        let times = latest.iter().map(|(channel, segment)| times_of(channel, segment));
        let mut is_silent = RecordTimes::silent(&times.collect::<Vec<_>>()).into_iter();
        let (silent, mut contributing): (Vec<_>, Vec<_>) =
            latest.into_iter().partition(|_| is_silent.next().unwrap_or(false));
        let estimates: Vec<(&str, &WearEstimate)> =
            contributing.iter().map(|(channel, segment)| (channel.channel.as_str(), &segment.wear)).collect();
        let Some(mut joint) = JointEstimate::of(&estimates) else {
            return Ok(None);
        };
        for (channel, segment) in &silent {
            joint.add_silent_channel(&channel.channel, &segment.wear, segment.start_time);
        }
        let (leading, segment) = contributing.swap_remove(joint.leading);
        let contributions = if channels.len() > 1 { joint.channels } else { Vec::new() };
        Ok(Some(Self { leading: leading.clone(), segment, wear: joint.wear, contributions }))
    }

    /// Computes the joint novelty of these channels, of up to `count` records of each from a time on: the
    /// last reading is of the latest record of each channel, the one before it of the second latest, and so
    /// on.
    pub(super) async fn novelty(
        store: &Store,
        channels: &[&ChannelSummary],
        from: Option<Timestamp>,
        count: u32,
    ) -> Result<Vec<AlarmReading>, StoreError> {
        let mut latest = Vec::with_capacity(channels.len());
        for channel in channels {
            let name = Some(channel.channel.clone());
            let order = Order::Desc;
            let filter =
                SegmentFilter { channel: name, from, counted: true, order, ..SegmentFilter::default() };
            let segments = store.segments(&channel.asset_id, &filter, count).await?;
            if !segments.is_empty() {
                latest.push((*channel, segments));
            }
        }
        let times = latest.iter().map(|(channel, segments)| times_of(channel, &segments[0]));
        let mut is_silent = RecordTimes::silent(&times.collect::<Vec<_>>()).into_iter();
        latest.retain(|_| !is_silent.next().unwrap_or(false));
        let reading = |back: usize| {
            let records =
                latest.iter().filter_map(|(channel, segments)| Some((channel, segments.get(back)?)));
            let time = records.clone().map(|(_, segment)| segment.start_time).max()?;
            let estimates: Vec<(&str, &WearEstimate)> =
                records.map(|(channel, segment)| (channel.channel.as_str(), &segment.wear)).collect();
            // A single channel has its own novelty alarm.
            let joint = JointEstimate::of(&estimates).filter(|_| estimates.len() > 1)?;
            let novelty = joint.wear.novelty.filter(|novelty| novelty.sensor_fault.is_none());
            Some(AlarmReading { time, value: novelty.map(|novelty| novelty.score) })
        };
        Ok((0..count as usize).rev().filter_map(reading).collect())
    }
}

fn times_of(channel: &ChannelSummary, latest: &Segment) -> RecordTimes {
    RecordTimes {
        first: channel.first_start_time.unwrap_or(latest.start_time),
        latest: latest.start_time,
        count: channel.segments,
    }
}
