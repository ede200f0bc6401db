//! Sensors that hear several meshes: each mesh is an asset, and the records that come for one of them are looked at for all.
//!
//! An asset that hears through another one has records, analyses, estimates and alarms of its own; raw bytes are kept once, and counted for
//! each. What a listener lacks of its sensor's records (it was described later, or the process ended in between) it gets in the background.

use std::collections::HashSet;
use std::sync::Arc;

use jiff::Timestamp;

use super::accept::Named;
use super::recall::recall_here;
use super::{Ingest, IngestError};
use crate::asset::{AssetId, AssetSpec, MOST_ON_ONE_SENSOR, Segment, SegmentId};
use crate::recording::RecordDefaults;
use crate::store::{Asset, ChannelSummary, SegmentFilter, SegmentKey, Store, StoreError};

/// Records looked at in one piece for an asset that lacks them.
const CAUGHT_UP_AT_ONCE: u32 = 32;

/// Who is to have the records that come for an asset.
pub(super) struct Hearers {
    /// The asset itself, the other meshes of its sensor known to it.
    pub(super) asset: Asset,
    /// Those that hear through its measuring points.
    pub(super) listeners: Vec<AssetSpec>,
}

impl Ingest {
    /// The description of an asset, the other meshes of its sensor known to it.
    pub(super) async fn asset_spec(&self, id: &AssetId) -> Result<AssetSpec, IngestError> {
        Ok(self.described(id).await?.spec)
    }

    /// An asset, the other meshes of its sensor known to its description.
    pub(super) async fn described(&self, id: &AssetId) -> Result<Asset, IngestError> {
        of_them(&self.inner.store.assets_of_sensor(id).await?, id)
    }

    /// An asset that was read by itself, with the other meshes of its sensor.
    pub(super) async fn among_others(&self, mut asset: Asset) -> Result<Asset, IngestError> {
        let all = self.inner.store.assets_of_sensor(&asset.spec.id).await?;
        let specs: Vec<AssetSpec> = all.into_iter().map(|asset| asset.spec).collect();
        asset.spec = asset.spec.among(&specs);
        Ok(asset)
    }

    /// Who is to have the records that come for an asset.
    ///
    /// Error: [`IngestError::HeardThrough`] where it has no measuring points of its own.
    pub(super) async fn hearers(&self, id: &AssetId) -> Result<Hearers, IngestError> {
        let all = self.inner.store.assets_of_sensor(id).await?;
        let asset = of_them(&all, id)?;
        if let Some(of) = &asset.spec.sensor.of {
            return Err(IngestError::HeardThrough {
                asset: id.clone(),
                of: of.clone(),
            });
        }
        let specs: Vec<AssetSpec> = all.into_iter().map(|asset| asset.spec).collect();
        let listeners = specs.iter().filter(|spec| spec.id != *id).map(|spec| spec.clone().among(&specs));
        Ok(Hearers {
            asset,
            listeners: listeners.collect(),
        })
    }

    /// The assets of the same sensor, this one among them.
    pub(super) async fn ids_of_sensor(&self, id: &AssetId) -> Result<Vec<AssetId>, IngestError> {
        let all = self.inner.store.assets_of_sensor(id).await?;
        Ok(all.into_iter().map(|asset| asset.spec.id).collect())
    }

    /// The assets of the same sensor, where none of them hears through this one.
    ///
    /// Error: [`IngestError::HeardByOthers`].
    pub(super) async fn ids_beside(&self, id: &AssetId) -> Result<Vec<AssetId>, IngestError> {
        let all = self.inner.store.assets_of_sensor(id).await?;
        let through = all.iter().filter(|asset| asset.spec.sensor.of.as_ref() == Some(id));
        let listeners: Vec<&str> = through.map(|asset| asset.spec.id.as_str()).collect();
        if !listeners.is_empty() {
            return Err(IngestError::HeardByOthers {
                asset: id.clone(),
                others: listeners.join(", "),
            });
        }
        Ok(all.into_iter().map(|asset| asset.spec.id).filter(|other| other != id).collect())
    }

    /// Checks what a description says of whose measuring points hear the mesh, against what the asset was `before` where there is one.
    pub(super) async fn check_sensor(&self, spec: &AssetSpec, before: Option<&AssetSpec>) -> Result<(), IngestError> {
        let store = &self.inner.store;
        let refuse = |expected: &'static str| {
            let value = spec.sensor.of.as_ref().map_or("not given".to_owned(), AssetId::to_string);
            Err(IngestError::Field {
                field: "sensor.of",
                value,
                expected,
            })
        };
        if let Some(before) = before
            && before.sensor.of != spec.sensor.of
            && store.channels(&spec.id).await?.iter().any(|channel| channel.segments > 0)
        {
            return refuse("what it was before, since the asset has records: describe the mesh as another asset");
        }
        let Some(of) = &spec.sensor.of else { return Ok(()) };
        let all = match store.assets_of_sensor(of).await {
            Err(StoreError::AssetUnknown(_)) => return refuse("the id of an asset that there is"),
            all => all?,
        };
        if all.iter().any(|other| other.spec.id == *of && other.spec.sensor.of.is_some()) {
            return refuse("an asset with measuring points of its own, not one that hears through another");
        }
        if all.iter().filter(|other| other.spec.id != spec.id).count() >= MOST_ON_ONE_SENSOR {
            return refuse("an asset through which fewer than 8 meshes are heard");
        }
        if before.is_some() && self.ids_beside(&spec.id).await.is_err() {
            return refuse("nothing, since other assets hear through this one");
        }
        Ok(())
    }

    /// Of records that come for an asset those that it has already and all its listeners have too.
    pub(super) async fn known_to_all(&self, named: &[&Named], listeners: &[AssetSpec]) -> Result<Vec<Segment>, IngestError> {
        let store = &self.inner.store;
        let ids: Vec<SegmentId> = named.iter().map(|named| named.id.clone()).collect();
        let mut known = store.segments_by_id(&ids).await?;
        for listener in listeners {
            let heard = named.iter().map(|named| (named.heard_by(listener).id, &named.id));
            let (heard, of): (Vec<SegmentId>, Vec<&SegmentId>) = heard.unzip();
            let found = store.segments_by_id(&heard).await?;
            let found: HashSet<&SegmentId> = found.iter().map(|segment| &segment.id).collect();
            let missing: HashSet<&SegmentId> = heard
                .iter()
                .zip(of)
                .filter(|(heard, _)| !found.contains(heard))
                .map(|(_, of)| of)
                .collect();
            known.retain(|segment| !missing.contains(&segment.id));
        }
        Ok(known)
    }

    /// Looks at records that are stored for an asset for those that hear through it as well. Asked for after they are stored, so that an asset
    /// that is described just now either is among the listeners or finds the records there. The caller holds `keeping`.
    pub(super) async fn let_hear(&self, of: &AssetId, named: &[Named], received_at: Timestamp) -> Result<(), IngestError> {
        for listener in self.hearers(of).await?.listeners {
            let heard = named.iter().map(|named| named.heard_by(&listener)).collect();
            self.hear(listener, heard, received_at).await?;
        }
        Ok(())
    }

    /// Stores what a listener does not have yet; returns how many that were. The caller holds `keeping`.
    async fn hear(&self, listener: AssetSpec, mut heard: Vec<Named>, received_at: Timestamp) -> Result<usize, IngestError> {
        let ids: Vec<SegmentId> = heard.iter().map(|named| named.id.clone()).collect();
        let known = self.inner.store.segments_by_id(&ids).await?;
        heard.retain(|named| !known.iter().any(|segment| segment.id == named.id));
        if heard.is_empty() {
            return Ok(0);
        }
        self.inner.libraries.tracker(&listener).await?;
        let heard = Arc::new(heard);
        let analysed = self.analyse(&listener, &heard, received_at).await?;
        let stored = self.store_analysed(listener, &heard, analysed, received_at).await?;
        Ok(stored.len())
    }

    /// Gives assets that hear through another one what they lack of its records, in the background; where records are handed over, workers do it
    /// when they are told of the asset.
    pub(super) fn catch_up_in_background(&self, listeners: Vec<AssetId>) {
        if listeners.is_empty() || self.is_entrance() {
            return;
        }
        let ingest = self.clone();
        tokio::spawn(async move {
            let _turn = ingest.inner.catching_up.lock().await;
            for listener in listeners {
                match ingest.catch_up(&listener).await {
                    Ok(0) | Err(IngestError::Store(StoreError::AssetUnknown(_))) => {}
                    Ok(records) => tracing::info!(asset = %listener, records, "earlier records of the sensor looked at"),
                    Err(error) => tracing::warn!(asset = %listener, %error, "earlier records of the sensor not looked at"),
                }
            }
        });
    }

    async fn catch_up(&self, listener: &AssetId) -> Result<usize, IngestError> {
        let Some(of) = self.inner.store.asset(listener).await?.spec.sensor.of else {
            return Ok(0);
        };
        let mut heard = 0;
        for channel in self.inner.store.channels(&of).await? {
            let mine = self.inner.store.channel(listener, &channel.channel).await?;
            // It has no others than its sensor's, so that as many are all.
            if mine.is_none_or(|mine| mine.segments < channel.segments) {
                heard += self.catch_up_channel(listener, &channel).await?;
            }
        }
        self.inner.store.caught_up(listener, &of).await?;
        Ok(heard)
    }

    /// Those of the segments of its sensor that a listener does not have.
    async fn unheard(&self, listener: &AssetId, mut segments: Vec<Segment>) -> Result<Vec<Segment>, IngestError> {
        let ids: Vec<SegmentId> = segments.iter().map(|segment| heard_id(listener, segment)).collect();
        let known = self.inner.store.segments_by_id(&ids).await?;
        let known: HashSet<&SegmentId> = known.iter().map(|segment| &segment.id).collect();
        segments.retain(|segment| !known.contains(&heard_id(listener, segment)));
        Ok(segments)
    }

    async fn catch_up_channel(&self, listener: &AssetId, channel: &ChannelSummary) -> Result<usize, IngestError> {
        let mut filter = SegmentFilter {
            channel: Some(channel.channel.clone()),
            ..SegmentFilter::default()
        };
        let mut heard = 0;
        loop {
            let segments = self.inner.store.segments(&channel.asset_id, &filter, CAUGHT_UP_AT_ONCE).await?;
            let Some(last) = segments.last() else { return Ok(heard) };
            filter.after = Some(SegmentKey {
                start_time: last.start_time,
                id: last.id.clone(),
            });
            let segments = self.unheard(listener, segments).await?;
            let spec = self.asked_for(listener).await?.0.spec;
            let _keeping = self.inner.keeping.read().await;
            let (store, of) = (self.inner.store.clone(), spec.clone());
            let recall = move || segments.iter().filter_map(|segment| heard_again(&store, &of, segment)).collect();
            let again: Vec<Named> = self.inner.workers.run("read records again", recall).await?;
            heard += self.hear(spec, again, self.inner.clock.now()).await?;
        }
    }
}

/// The record that a segment is for a listener.
fn heard_id(listener: &AssetId, segment: &Segment) -> SegmentId {
    SegmentId::derive(listener, &segment.channel, segment.start_time, &segment.raw)
}

/// One of the assets of a sensor, the others known to its description.
fn of_them(all: &[Asset], id: &AssetId) -> Result<Asset, IngestError> {
    let asset = all.iter().find(|asset| asset.spec.id == *id).cloned();
    let mut asset = asset.ok_or_else(|| StoreError::AssetUnknown(id.clone()))?;
    let specs: Vec<AssetSpec> = all.iter().map(|asset| asset.spec.clone()).collect();
    asset.spec = asset.spec.among(&specs);
    Ok(asset)
}

/// A stored record as a listener hears it; none where its raw bytes are not kept any more.
fn heard_again(store: &Store, listener: &AssetSpec, segment: &Segment) -> Option<Named> {
    let defaults = RecordDefaults {
        channel: Some(segment.channel.clone()),
        start_time: segment.start_time,
        unit: Some(segment.unit.clone()),
        operating_point: segment.operating_point,
        ..RecordDefaults::default()
    };
    let record = recall_here(store, &segment.raw, &defaults)
        .inspect_err(|error| tracing::debug!(segment = %segment.id, %error, "not heard by those that hear through its asset"))
        .ok()?;
    Some(Named::of_stored(
        &listener.id,
        record.with_channel(&segment.channel),
        segment.raw.clone(),
    ))
}
