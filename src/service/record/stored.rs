//! Reads stored records from their raw bytes, and computes their spectra.

use std::ops::Deref;
use std::sync::Arc;

use bytes::Bytes;
use jiff::Timestamp;
use tokio::sync::OwnedSemaphorePermit;

use super::decode::{RecordFormat, StoredMediaType};
use crate::asset::{RawReference, Segment};
use crate::recording::{RecordDefaults, RecordingError};
use crate::service::error::ServiceError;
use crate::service::sensor_group::described;
use crate::service::workers::{Workers, blocking, with_analyzer};
use crate::signal::{
    Analyzer, BandError, BandSource, EnvelopeBand, EnvelopeSearch, MeshContext, MeshLine, OperatingPoint,
    Record, Spectrum,
};
use crate::store::{NewSegment, RecordMetadata, Store, StoreError};

/// The metadata of a stored record that is needed to decode its raw bytes.
pub(crate) struct StoredRecord {
    channel: String,
    start_time: Timestamp,
    unit: String,
    operating_point: OperatingPoint,
    raw: RawReference,
}

macro_rules! stored_record_from {
    ($($source:ty),+) => {$(
        impl From<&$source> for StoredRecord {
            fn from(source: &$source) -> Self {
                Self {
                    channel: source.channel.clone(),
                    start_time: source.start_time,
                    unit: source.unit.clone(),
                    operating_point: source.operating_point,
                    raw: source.raw.clone(),
                }
            }
        }
    )+};
}

stored_record_from!(Segment, NewSegment, RecordMetadata);

impl StoredRecord {
    /// Reads the record from its raw bytes, which are checked against their hash. Blocks on the disk or the
    /// network.
    pub(crate) fn read(&self, store: &Store) -> Result<Record, ServiceError> {
        self.decode(&store.objects().get(&self.raw.sha256)?)
    }

    /// Decodes the record from its raw bytes.
    pub(crate) fn decode(&self, bytes: &[u8]) -> Result<Record, ServiceError> {
        let unexpected = |what, value, expected| StoreError::Unexpected { what, value, expected };
        let media_type = &self.raw.media_type;
        let StoredMediaType { has_every_series, unit, .. } = StoredMediaType::of(media_type);
        let format = RecordFormat::from_media_type(media_type)
            .ok_or_else(|| unexpected("raw_media_type", media_type.clone(), "a media type of one record"))?;
        let defaults = RecordDefaults {
            channel: Some(self.channel.clone()),
            start_time: self.start_time,
            unit: Some(unit.unwrap_or(&self.unit).to_owned()),
            operating_point: self.operating_point,
            every_series: has_every_series,
            ..RecordDefaults::default()
        };
        let index = self.raw.channel_index;
        let record = format.decode(bytes, &defaults)?.into_iter().nth(index as usize);
        let record = record.ok_or_else(|| {
            unexpected("raw_channel_index", index.to_string(), "a channel of the recording")
        })?;
        let record = record.with_channel(&self.channel).in_unit(&self.unit);
        Ok(record.map_err(RecordingError::from)?)
    }
}

/// Reads raw bytes and checks them against their hash, on a blocking thread, so that no worker thread waits
/// for the disk or the network.
pub(crate) async fn raw_bytes(store: &Store, name: &str) -> Result<Bytes, ServiceError> {
    let (store, name) = (store.clone(), name.to_owned());
    Ok(blocking("read a record", move || store.objects().get(&name)).await??)
}

/// A stored record in memory, with its share of the memory for them.
pub struct LoadedRecord {
    record: Record,
    _memory: OwnedSemaphorePermit,
}

impl Deref for LoadedRecord {
    type Target = Record;

    fn deref(&self) -> &Record {
        &self.record
    }
}

/// The most memory that reading a segment's record takes, in bytes: the raw bytes and the samples of every
/// channel in them, where one byte is one sample at most.
fn memory_of(segment: &Segment) -> u64 {
    let channels = u64::from(segment.raw.channel_index) + 1;
    let samples = segment.raw.bytes.max(segment.samples.saturating_mul(channels));
    segment.raw.bytes.saturating_add(samples.saturating_mul(4))
}

/// Reads stored records and computes their spectra.
pub struct StoredRecords {
    store: Store,
    workers: Arc<Workers>,
}

impl StoredRecords {
    /// Creates a reader of the records in a store, which analyses them on these workers.
    pub(crate) fn new(store: Store, workers: Arc<Workers>) -> Self {
        Self { store, workers }
    }

    /// Checks the raw bytes of a segment against their hash; returns their number.
    ///
    /// # Errors
    /// [`ServiceError::RawDeleted`].
    pub async fn check_raw(&self, segment: &Segment) -> Result<u64, ServiceError> {
        let (store, name) = (self.store.clone(), segment.raw.sha256.clone());
        let checked = blocking("read a record", move || store.objects().check(&name)).await?;
        self.unless_deleted(segment, checked).await
    }

    /// Reads the piece of a segment's `bytes` raw bytes that starts at `offset`.
    pub async fn raw_piece(&self, segment: &Segment, bytes: u64, offset: u64) -> Result<Bytes, ServiceError> {
        let (store, name) = (self.store.clone(), segment.raw.sha256.clone());
        let read = move || store.objects().object_piece(&name, bytes, offset);
        Ok(blocking("read a record", read).await??)
    }

    /// Reads the record of a segment from its raw bytes, checked against their hash. Waits until there is
    /// memory for it.
    ///
    /// # Errors
    /// [`ServiceError::RawDeleted`].
    pub async fn load(&self, segment: &Segment) -> Result<LoadedRecord, ServiceError> {
        let memory = self.workers.memory_for_stored(memory_of(segment)).await?;
        let (store, name) = (self.store.clone(), segment.raw.sha256.clone());
        // The memory stays reserved while it is in use, even if the caller is gone.
        let read = move || store.objects().get(&name).map(|bytes| (bytes, memory));
        let (bytes, memory) = self.unless_deleted(segment, blocking("read a record", read).await?).await?;
        let stored = StoredRecord::from(segment);
        let decode = move || Ok(LoadedRecord { record: stored.decode(&bytes)?, _memory: memory });
        self.workers.run("read a record", decode).await?
    }

    /// What was read of a segment's raw bytes, or that they were deleted, if that is why they are missing.
    async fn unless_deleted<T>(
        &self,
        segment: &Segment,
        read: Result<T, StoreError>,
    ) -> Result<T, ServiceError> {
        let name = &segment.raw.sha256;
        match read {
            Err(StoreError::ObjectMissing(_)) if !self.store.keeps_raw(&segment.asset_id, name).await? => {
                Err(ServiceError::RawDeleted(segment.id.clone()))
            }
            read => Ok(read.inspect_err(
                |error| tracing::warn!(segment = %segment.id, %error, "failed to read a raw recording"),
            )?),
        }
    }

    /// Runs `analyse` on a segment's record and the context of its mesh; `task` names it in the error if it
    /// panics.
    pub async fn analyse_stored<T: Send + 'static>(
        &self,
        segment: &Segment,
        task: &'static str,
        analyse: impl FnOnce(&mut Analyzer, &Record, &MeshContext) -> T + Send + 'static,
    ) -> Result<T, ServiceError> {
        let spec = described(&self.store, &segment.asset_id).await?.spec;
        let record = self.load(segment).await?;
        let samples = record.samples().len();
        let analyse = move || {
            with_analyzer(samples, |analyzer| {
                analyse(analyzer, &spec.seen_from_shaft(&record), &spec.mesh_context())
            })
        };
        self.workers.run_analysis(task, samples, analyse).await
    }

    /// Computes the amplitude spectrum of a segment and its mesh harmonics.
    pub async fn spectrum(&self, segment: &Segment) -> Result<(Spectrum, Vec<MeshLine>), ServiceError> {
        let analyse = |analyzer: &mut Analyzer, record: &Record, mesh: &MeshContext| {
            let lines = analyzer.analyze(record, mesh).mesh_lines;
            (analyzer.amplitude_spectrum(record), lines)
        };
        self.analyse_stored(segment, "compute a spectrum", analyse).await
    }

    /// Computes the envelope spectrum of a segment in the requested band, else in that of the asset, else in
    /// the one found in the record.
    pub async fn envelope(
        &self,
        segment: &Segment,
        choice: BandChoice,
    ) -> Result<SegmentEnvelope, ServiceError> {
        let spec = described(&self.store, &segment.asset_id).await?.spec;
        let record = self.load(segment).await?;
        let speed = segment.shaft_speed;
        let samples = record.samples().len();
        let analyse = move || {
            with_analyzer(samples, |analyzer| {
                let given = match choice {
                    BandChoice::Hertz(band_hz) => Some(EnvelopeBand::given(band_hz, BandSource::Query)),
                    BandChoice::OfAsset => spec.given_envelope_band(),
                    BandChoice::Search(_) => None,
                };
                let search = match choice {
                    BandChoice::Search(search) => search,
                    _ => spec.envelope_band,
                };
                let of_record = || match (&spec.gear, search) {
                    (None, EnvelopeSearch::MeshHarmonic) => EnvelopeBand::of_impacts(record.sample_rate_hz()),
                    _ => analyzer.envelope_band(&record, speed.as_ref(), search),
                };
                let band = given.unwrap_or_else(of_record);
                let mesh_lines =
                    analyzer.analyze(&spec.seen_from_shaft(&record), &spec.mesh_context()).mesh_lines;
                let [low, high] = band.band_hz;
                let was_given = matches!(band.source, BandSource::Query | BandSource::Asset);
                let spectrum = match analyzer.envelope_spectrum(&record, band.band_hz) {
                    Ok(spectrum) => spectrum,
                    // The record is too short for any band that the search could find.
                    Err(BandError::TooNarrow { .. }) if !was_given => {
                        Spectrum { amplitude: Vec::new(), ..analyzer.amplitude_spectrum(&record) }
                    }
                    Err(error) => {
                        return Err(ServiceError::Field {
                            field: "band_hz",
                            value: format!("[{low}, {high}] ({error})"),
                            expected: "a band between 0 and half the sampling rate that the record resolves"
                                .into(),
                        });
                    }
                };
                Ok(SegmentEnvelope { spectrum, band, mesh_lines })
            })
        };
        let workers = &self.workers;
        workers.run_analysis("compute an envelope spectrum", samples, analyse).await?
    }
}

/// The requested band of an envelope spectrum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum BandChoice {
    /// The band of the asset.
    OfAsset,
    /// The band found by this search.
    Search(EnvelopeSearch),
    /// The band from the first to the second frequency in hertz.
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
