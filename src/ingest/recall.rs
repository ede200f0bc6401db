//! Stored records again: their samples and their spectra, from the raw bytes.

use bytes::Bytes;

use super::accept::RecordFormat;
use super::{Ingest, IngestError, with_analyzer};
use crate::asset::{RawReference, Segment};
use crate::recording::RecordDefaults;
use crate::signal::{Analyzer, BandError, BandSource, EnvelopeBand, EnvelopeSearch, MeshContext, MeshLine, Record, Spectrum};
use crate::store::{Store, StoreError};

impl Ingest {
    /// The record that a segment was made of, read from its raw bytes and checked against their hash.
    pub async fn recall(&self, segment: &Segment) -> Result<Record, IngestError> {
        let raw = segment.raw.clone();
        let defaults = RecordDefaults {
            channel: Some(segment.channel.clone()),
            start_time: segment.start_time,
            unit: Some(segment.unit.clone()),
            operating_point: segment.operating_point,
            ..RecordDefaults::default()
        };
        let bytes = match self.raw_bytes(&raw).await {
            Err(IngestError::Store(StoreError::ObjectMissing(name))) if !self.inner.store.keeps_raw(&segment.asset_id, &name).await? => {
                return Err(IngestError::RawGivenUp(segment.id.clone()));
            }
            read => read.inspect_err(|error| tracing::warn!(segment = %segment.id, %error, "raw recording cannot be read"))?,
        };
        let decode = move || decode_again(&bytes, &raw, &defaults);
        self.inner.workers.run("read a record", decode).await?
    }

    /// Raw bytes, checked against their hash. No thread that computes waits for the disk or the network.
    pub(super) async fn raw_bytes(&self, raw: &RawReference) -> Result<Bytes, IngestError> {
        let (store, name) = (self.inner.store.clone(), raw.sha256.clone());
        let read = tokio::task::spawn_blocking(move || store.objects().get(&name)).await;
        Ok(read.map_err(|_| IngestError::WorkerLost("read a record"))??)
    }

    /// What `analyse` makes of a segment's record and of what is known of its mesh; `task` names it if it is lost.
    pub async fn analyse_stored<T: Send + 'static>(
        &self,
        segment: &Segment,
        task: &'static str,
        analyse: impl FnOnce(&mut Analyzer, &Record, &MeshContext) -> T + Send + 'static,
    ) -> Result<T, IngestError> {
        let spec = self.asset_spec(&segment.asset_id).await?;
        let record = self.recall(segment).await?;
        let samples = record.samples().len();
        let analyse = move || {
            with_analyzer(samples, |analyzer| {
                analyse(analyzer, &spec.seen_from_shaft(&record), &spec.mesh_context())
            })
        };
        self.inner.workers.run_analysis(task, samples, analyse).await
    }

    /// The amplitude spectrum of a segment and its mesh harmonics.
    pub async fn spectrum(&self, segment: &Segment) -> Result<(Spectrum, Vec<MeshLine>), IngestError> {
        let spec = self.asset_spec(&segment.asset_id).await?;
        let record = self.recall(segment).await?;
        let samples = record.samples().len();
        let analyse = move || {
            with_analyzer(samples, |analyzer| {
                let lines = analyzer.analyze(&spec.seen_from_shaft(&record), &spec.mesh_context()).mesh_lines;
                (analyzer.amplitude_spectrum(&record), lines)
            })
        };
        self.inner.workers.run_analysis("compute a spectrum", samples, analyse).await
    }

    /// The envelope spectrum of a segment in the band asked for, else in the asset's, else in the one found in the record.
    pub async fn envelope(&self, segment: &Segment, asked: AskedBand) -> Result<SegmentEnvelope, IngestError> {
        let spec = self.asset_spec(&segment.asset_id).await?;
        let record = self.recall(segment).await?;
        let speed = segment.shaft_speed;
        let samples = record.samples().len();
        let analyse = move || {
            with_analyzer(samples, |analyzer| {
                let given = match asked {
                    AskedBand::Hertz(band_hz) => Some(EnvelopeBand::given(band_hz, BandSource::Query)),
                    AskedBand::Nothing => spec.given_envelope_band(),
                    AskedBand::Search(_) => None,
                };
                let search = match asked {
                    AskedBand::Search(search) => search,
                    _ => spec.envelope_band,
                };
                let band = given.unwrap_or_else(|| analyzer.envelope_band(&record, speed.as_ref(), search));
                let mesh_lines = analyzer.analyze(&spec.seen_from_shaft(&record), &spec.mesh_context()).mesh_lines;
                let [low, high] = band.band_hz;
                let was_given = matches!(band.source, BandSource::Query | BandSource::Asset);
                let spectrum = match analyzer.envelope_spectrum(&record, band.band_hz) {
                    Ok(spectrum) => spectrum,
                    // Of the band that was looked for nothing is to be had: the record is too short for any.
                    Err(BandError::TooNarrow { .. }) if !was_given => Spectrum {
                        amplitude: Vec::new(),
                        ..analyzer.amplitude_spectrum(&record)
                    },
                    Err(error) => {
                        return Err(IngestError::Field {
                            field: "band_hz",
                            value: format!("[{low}, {high}] ({error})"),
                            expected: "a band between 0 and half the sampling rate that the record resolves",
                        });
                    }
                };
                Ok(SegmentEnvelope {
                    spectrum,
                    band,
                    mesh_lines,
                })
            })
        };
        let workers = &self.inner.workers;
        workers.run_analysis("compute an envelope spectrum", samples, analyse).await?
    }
}

/// The band that an envelope spectrum is asked for in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum AskedBand {
    /// That of the asset.
    Nothing,
    /// The one that is found so.
    Search(EnvelopeSearch),
    /// From the first to the second frequency in hertz.
    Hertz([f64; 2]),
}

/// The envelope spectrum of a segment.
#[derive(Debug, Clone, PartialEq)]
pub struct SegmentEnvelope {
    /// The spectrum.
    pub spectrum: Spectrum,
    /// The band, and how it was chosen.
    pub band: EnvelopeBand,
    /// The mesh harmonics of the segment's own spectrum.
    pub mesh_lines: Vec<MeshLine>,
}

/// A record from its raw bytes, checked against their hash; `defaults` is what was stored of it. Blocks on the disk.
pub(super) fn recall_here(store: &Store, raw: &RawReference, defaults: &RecordDefaults) -> Result<Record, IngestError> {
    decode_again(&store.objects().get(&raw.sha256)?, raw, defaults)
}

/// A record from its raw bytes; `defaults` is what was stored of it.
pub(super) fn decode_again(bytes: &[u8], raw: &RawReference, defaults: &RecordDefaults) -> Result<Record, IngestError> {
    let format = RecordFormat::from_media_type(&raw.media_type).ok_or_else(|| StoreError::Unexpected {
        what: "raw_media_type",
        value: raw.media_type.clone(),
        expected: "a media type of one record",
    })?;
    let records = format.decode(bytes, defaults)?;
    let record = records.into_iter().nth(raw.channel_index as usize);
    let record = record.ok_or_else(|| StoreError::Unexpected {
        what: "raw_channel_index",
        value: raw.channel_index.to_string(),
        expected: "a channel of the recording",
    })?;
    Ok(record)
}
