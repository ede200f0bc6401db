//! What happened, as those who follow the service are told.

use crate::asset::AssetId;

/// One thing that happened, in the words of the API.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LiveEvent {
    /// What kind of thing: `wear`, `alarm`, …
    pub kind: String,
    /// The asset that it is about; none where it is about all.
    pub asset: Option<AssetId>,
    /// What happened, in JSON.
    pub data: String,
}

/// The same with its place in what all nodes of a cluster show.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NumberedEvent {
    /// Rises from event to event.
    pub number: u64,
    /// What happened.
    pub event: LiveEvent,
}
