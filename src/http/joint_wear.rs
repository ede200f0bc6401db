//! What an asset's channels say together, from the latest record of each.

use super::app::App;
use super::problem::Problem;
use crate::asset::Segment;
use crate::estimate::{ChannelContribution, JointEstimate, WearEstimate};
use crate::store::{Asset, ChannelSummary};

/// The answer of an asset that has records.
pub(super) struct JointWear {
    /// The channel that says most.
    pub(super) leading: ChannelSummary,
    /// Its latest record that is not excluded.
    pub(super) segment: Segment,
    /// The one answer.
    pub(super) wear: WearEstimate,
    /// What each channel adds; empty where one speaks alone.
    pub(super) contributions: Vec<ChannelContribution>,
}

/// The channels that speak for an asset: the one that its description names alone, else all.
pub(super) fn speakers<'a>(asset: &Asset, channels: &'a [ChannelSummary]) -> Vec<&'a ChannelSummary> {
    let named = asset.spec.sensor.channel.as_deref();
    let named = named.and_then(|name| channels.iter().find(|channel| channel.channel == name));
    named.map_or_else(|| channels.iter().collect(), |named| vec![named])
}

/// What these channels say together; none without records.
pub(super) async fn of(app: &App, speakers: &[&ChannelSummary]) -> Result<Option<JointWear>, Problem> {
    let mut latest = Vec::with_capacity(speakers.len());
    for channel in speakers {
        if let Some(segment) = app.service.store.latest_counted(channel).await? {
            latest.push((*channel, segment));
        }
    }
    let told: Vec<(&str, &WearEstimate)> =
        latest.iter().map(|(channel, segment)| (channel.channel.as_str(), &segment.wear)).collect();
    let Some(joint) = JointEstimate::of(&told) else {
        return Ok(None);
    };
    let (leading, segment) = latest.swap_remove(joint.leading);
    let contributions = if speakers.len() > 1 { joint.channels } else { Vec::new() };
    Ok(Some(JointWear { leading: leading.clone(), segment, wear: joint.wear, contributions }))
}
