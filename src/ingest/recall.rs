//! Stored records again: their samples and their spectra, from the raw bytes.

use std::sync::Arc;

use super::accept::RecordFormat;
use super::{Ingest, IngestError, with_analyzer};
use crate::asset::Segment;
use crate::recording::RecordDefaults;
use crate::signal::{BandSource, MeshLine, Record, Spectrum};
use crate::store::StoreError;

impl Ingest {
    /// The record that a segment was made of, read from its raw bytes and checked against their hash.
    pub async fn recall(&self, segment: &Segment) -> Result<Record, IngestError> {
        let (store, segment) = (self.inner.store.clone(), segment.clone());
        self.inner
            .workers
            .run("read a record", move || recall_here(&store, &segment))
            .await?
    }

    /// The amplitude spectrum of a segment and its mesh harmonics.
    pub async fn spectrum(&self, segment: &Segment) -> Result<(Spectrum, Vec<MeshLine>), IngestError> {
        let mesh = self.inner.store.asset(&segment.asset_id).await?.spec.mesh_context();
        let record = Arc::new(self.recall(segment).await?);
        let analyse = move || {
            with_analyzer(|analyzer| {
                let lines = analyzer.analyze(&record, &mesh).mesh_lines;
                (analyzer.amplitude_spectrum(&record), lines)
            })
        };
        self.inner.workers.run("compute a spectrum", analyse).await
    }

    /// The envelope spectrum of a segment: in the band asked for, else in the asset's, else in the one found in the record.
    pub async fn envelope(
        &self,
        segment: &Segment,
        asked: Option<[f64; 2]>,
    ) -> Result<(Spectrum, [f64; 2], BandSource, Vec<MeshLine>), IngestError> {
        let spec = self.inner.store.asset(&segment.asset_id).await?.spec;
        let record = self.recall(segment).await?;
        let speed = segment.shaft_speed;
        let analyse = move || {
            with_analyzer(|analyzer| {
                let (band, source) = match (asked, spec.envelope_band_hz) {
                    (Some(band), _) => (band, BandSource::Query),
                    (None, Some(band)) => (band, BandSource::Asset),
                    (None, None) => analyzer.envelope_band(&record, speed.as_ref()),
                };
                let lines = analyzer.analyze(&record, &spec.mesh_context()).mesh_lines;
                let spectrum = analyzer.envelope_spectrum(&record, band).map_err(|error| IngestError::Field {
                    field: "band_hz",
                    value: format!("[{}, {}] ({error})", band[0], band[1]),
                    expected: "a band between 0 and half the sampling rate that the record resolves",
                })?;
                Ok((spectrum, band, source, lines))
            })
        };
        self.inner.workers.run("compute an envelope spectrum", analyse).await?
    }
}

fn recall_here(store: &crate::store::Store, segment: &Segment) -> Result<Record, IngestError> {
    let raw = &segment.raw;
    let bytes = store.objects().get(&raw.sha256)?;
    let format = RecordFormat::from_media_type(&raw.media_type).ok_or_else(|| StoreError::Unexpected {
        what: "raw_media_type",
        value: raw.media_type.clone(),
        expected: "a media type of one record",
    })?;
    let defaults = RecordDefaults {
        channel: Some(segment.channel.clone()),
        start_time: segment.start_time,
        unit: Some(segment.unit.clone()),
        operating_point: segment.operating_point,
    };
    let records = format.decode(&bytes, &defaults)?;
    let record = records.into_iter().nth(raw.channel_index as usize);
    let record = record.ok_or_else(|| StoreError::Unexpected {
        what: "raw_channel_index",
        value: raw.channel_index.to_string(),
        expected: "a channel of the recording",
    })?;
    Ok(record)
}
