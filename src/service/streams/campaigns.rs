//! Measuring campaigns, during which every sample of a stream becomes part of a record.

use std::sync::Arc;

use jiff::Timestamp;
use serde::Serialize;

use super::Streams;
use super::cutting::Cutting;
use super::state::StreamState;
use crate::asset::AssetId;
use crate::service::error::ServiceError;

/// A measuring campaign.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[schema(as = CampaignView)]
pub struct CampaignStatus {
    /// Whether it is running.
    pub is_running: bool,
    /// Index of the first sample.
    pub first: u64,
    /// Index after the last sample.
    pub end: u64,
    /// The time of the first sample: `from` of an export of its records.
    pub start_time: Timestamp,
    /// The time at which it ends or ended: `to` of an export of its records.
    pub end_time: Option<Timestamp>,
    /// Records made by it; those of all channels count as one.
    pub records: u64,
}

impl CampaignStatus {
    pub(super) fn of(state: &StreamState) -> Option<Self> {
        let campaign = state.campaign.as_ref()?;
        Some(Self {
            is_running: state.capture.is_some_and(|capture| capture.is_campaign),
            first: campaign.first,
            end: campaign.until,
            start_time: campaign.start_time,
            end_time: campaign.end_time.or_else(|| state.time(campaign.until)),
            records: campaign.records,
        })
    }
}

impl Streams {
    /// Starts a campaign of this many seconds from now on, or sets the end of the running one to then.
    ///
    /// # Errors
    /// [`ServiceError::StreamUnknown`], also if the stream has no sample yet; the asset's records are too
    /// large.
    pub async fn begin_campaign(
        self: &Arc<Self>,
        asset: &AssetId,
        name: &str,
        seconds: f64,
    ) -> Result<CampaignStatus, ServiceError> {
        let spec = self.store.asset(asset).await?.spec;
        let begun = self.of_stream(asset, name, move |stream, stored| {
            let format = stored.state().format.clone();
            let cutting = Cutting::of(&spec, &format)?;
            if !stored.begin_campaign(format.frames_in(seconds).max(1), &cutting)? {
                return Err(stream.unknown());
            }
            CampaignStatus::of(stored.state()).ok_or_else(|| stream.unknown())
        });
        let begun = begun.await?;
        self.cut_in_background(&self.find(asset, name).await?);
        Ok(begun)
    }

    /// Ends the running campaign, if there is one.
    ///
    /// # Errors
    /// [`ServiceError::StreamUnknown`].
    pub async fn end_campaign(self: &Arc<Self>, asset: &AssetId, name: &str) -> Result<(), ServiceError> {
        let spec = self.store.asset(asset).await?.spec;
        let ended = self.of_stream(asset, name, move |_, stored| {
            let cutting = Cutting::of(&spec, &stored.state().format)?;
            stored.end_campaign(&cutting)
        });
        ended.await?;
        self.cut_in_background(&self.find(asset, name).await?);
        Ok(())
    }
}
