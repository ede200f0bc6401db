//! Measuring campaigns: for a time every sample of a stream becomes a record.

use std::sync::Arc;

use jiff::Timestamp;

use super::Streams;
use super::cutting::Cutting;
use super::state::StreamState;
use crate::asset::AssetId;
use crate::service::error::ServiceError;

/// How a measuring campaign stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CampaignStatus {
    /// It goes on.
    pub is_running: bool,
    /// Index of the first sample.
    pub first: u64,
    /// Index after the last one.
    pub end: u64,
    /// The time of the first sample: no record of it begins earlier.
    pub start_time: Timestamp,
    /// The time at which it ends or ended: all of its records begin earlier.
    pub end_time: Option<Timestamp>,
    /// Times at which samples became records for it.
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
    /// Makes records of everything for so many seconds from now on; where a campaign runs it ends then.
    ///
    /// Errors: [`ServiceError::StreamUnknown`]; there was no sample yet; the asset's records are too large.
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
        self.cut_in_background(&self.find(asset, name, false)?);
        Ok(begun)
    }

    /// Ends the campaign that runs, if one does.
    ///
    /// Error: [`ServiceError::StreamUnknown`].
    pub async fn end_campaign(self: &Arc<Self>, asset: &AssetId, name: &str) -> Result<(), ServiceError> {
        let spec = self.store.asset(asset).await?.spec;
        let ended = self.of_stream(asset, name, move |_, stored| {
            let cutting = Cutting::of(&spec, &stored.state().format)?;
            stored.end_campaign(&cutting)
        });
        ended.await?;
        self.cut_in_background(&self.find(asset, name, false)?);
        Ok(())
    }
}
