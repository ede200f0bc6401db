//! Sends the records cut from a stream through the pipeline.

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;

use super::Streams;
use super::live::{CutRecord, LiveStream, NextCut};
use crate::asset::AssetId;
use crate::recording::{BlockEncoding, encode_block};
use crate::service::error::ServiceError;
use crate::service::record::{ChannelUnits, RecordFormat, UploadMetadata, decode_upload};
use crate::service::workers::blocking;
use crate::signal::Record;
use crate::store::StoreError;

/// First and longest wait before a record is retried.
const RETRY_AFTER: Duration = Duration::from_millis(200);
const MAX_RETRY: Duration = Duration::from_secs(30);

/// Wait before the next look at the records that another process stores.
const LOOK_AGAIN: Duration = Duration::from_millis(500);

/// The outcome of an attempt to store the next record.
enum Attempt {
    Stored,
    /// Another process stores the records.
    Elsewhere,
    NonePending,
}

impl Streams {
    /// Stores pending records in the background, one after the other.
    pub(super) fn cut_in_background(self: &Arc<Self>, stream: &Arc<LiveStream>) {
        if !stream.begin_cutting() {
            return;
        }
        let (streams, stream) = (Arc::clone(self), Arc::clone(stream));
        tokio::spawn(async move {
            loop {
                streams.store_cuts(&stream).await;
                stream.end_cutting();
                // One may have been added since the last check.
                if *streams.is_over.borrow() || !stream.begin_cutting() {
                    return;
                }
            }
        });
    }

    /// Stores records until none is pending or the service ends.
    async fn store_cuts(&self, stream: &Arc<LiveStream>) {
        let (mut wait, mut over) = (RETRY_AFTER, self.watch_end());
        loop {
            match self.store_next(stream).await {
                Ok(Attempt::Stored) => wait = RETRY_AFTER,
                Ok(Attempt::NonePending) => return,
                Ok(Attempt::Elsewhere) => {
                    tokio::select! {
                        _ = over.wait_for(|over| *over) => return,
                        () = tokio::time::sleep(LOOK_AGAIN) => {}
                    }
                }
                Err(error) => {
                    let (asset, name) = (&stream.asset, &stream.name);
                    tracing::warn!(%asset, name, %error, "failed to store a record of a stream; retrying");
                    tokio::select! {
                        _ = over.wait_for(|over| *over) => return,
                        () = tokio::time::sleep(wait) => wait = (wait * 2).min(MAX_RETRY),
                    }
                }
            }
            if *over.borrow() {
                return;
            }
        }
    }

    /// Stores the next record.
    async fn store_next(&self, stream: &Arc<LiveStream>) -> Result<Attempt, ServiceError> {
        let _permit = self.records_at_once.acquire().await;
        if *self.is_over.borrow() {
            return Ok(Attempt::NonePending);
        }
        let reader = Arc::clone(stream);
        let read = move || reader.next_cut();
        let next = match self.storage.shared() {
            // Not one by one: a database is slower than a disk.
            Some(_) => blocking("read a stream", read).await,
            None => self.workers.run_reading("read a stream", read).await,
        };
        let record = match next? {
            Ok(NextCut::Record(record)) => *record,
            Ok(NextCut::Elsewhere) => return Ok(Attempt::Elsewhere),
            // It was removed in the meantime.
            Ok(NextCut::None) | Err(ServiceError::StreamUnknown { .. }) => return Ok(Attempt::NonePending),
            Err(error) => return Err(error),
        };
        let pending = record.pending.clone();
        let first = pending.cut.first;
        let refusal = match self.store_record(&stream.asset, record).await {
            Ok(()) => None,
            Err(ServiceError::Store(StoreError::AssetUnknown(_))) => {
                self.remove_each(vec![Arc::clone(stream)]).await?;
                return Ok(Attempt::NonePending);
            }
            Err(
                error @ (ServiceError::Recording(_)
                | ServiceError::Field { .. }
                | ServiceError::SensorOfOther { .. }),
            ) => {
                let (asset, name) = (&stream.asset, &stream.name);
                tracing::warn!(%asset, name, first, %error, "skipped an invalid record of a stream");
                Some(error.to_string())
            }
            Err(error) => return Err(error),
        };
        let writer = Arc::clone(stream);
        let done = move || writer.with_stored(|stored| stored.finish_record(&pending, refusal));
        match blocking("write a stream", done).await? {
            Err(ServiceError::StreamUnknown { .. }) => Ok(Attempt::NonePending),
            done => done.map(|()| Attempt::Stored),
        }
    }

    async fn store_record(&self, asset: &AssetId, record: CutRecord) -> Result<(), ServiceError> {
        let described = self.store.asset(asset).await?;
        if described.created_at != record.asset_created_at {
            return Err(StoreError::AssetUnknown(asset.clone()).into());
        }
        let separate = move || record.with_pulses_of_channel();
        let CutRecord { pending, format, bytes, tachometer, .. } =
            blocking("find the pulses of a stream", separate).await?;
        let metadata = UploadMetadata {
            start_time: Some(pending.start_time),
            channel_names: format.channel_names.clone(),
            unit: format.unit.clone(),
            operating_point: pending.operating_point,
            ..UploadMetadata::default()
        };
        let format = RecordFormat::Raw(format.layout()?);
        let Some(tachometer) = tachometer else {
            return self.accept(asset, format, bytes, metadata).await;
        };
        // Bare samples cannot carry pulses; blocks of one channel can.
        let units = ChannelUnits::load(&self.store, &described.spec).await?;
        let start_time = pending.start_time;
        let blocks = move || -> Result<Vec<Vec<u8>>, ServiceError> {
            let records = decode_upload(&described.spec, &units, format, &bytes, &metadata, start_time)?;
            let block = |record: Record| {
                encode_block(&record.with_tachometer(Some(tachometer.clone())), BlockEncoding::Protobuf)
            };
            Ok(records.into_iter().map(block).collect())
        };
        for block in blocking("encode a record of a stream", blocks).await?? {
            let bytes = block.into();
            self.accept(asset, RecordFormat::Protobuf, bytes, UploadMetadata::default()).await?;
        }
        Ok(())
    }

    async fn accept(
        &self,
        asset: &AssetId,
        format: RecordFormat,
        bytes: Bytes,
        metadata: UploadMetadata,
    ) -> Result<(), ServiceError> {
        let mut ticket = self.workers.admit()?;
        ticket.grow(bytes.len())?;
        self.pipeline.accept(asset, format, bytes, metadata, ticket).await.map(|_| ())
    }
}
