//! One record, or one recording of several channels, from its bytes to its segments.

use std::sync::Arc;

use bytes::Bytes;
use jiff::Timestamp;
use rayon::prelude::*;
use tokio::sync::RwLockReadGuard;

use super::group_commit::Stored;
use super::hearing::Hearers;
use super::kept_raw::KeptRaw;
use super::keys::analysis_keys;
use super::workers::is_large;
use super::{Ingest, IngestError, Part, QueuedRecord, Ticket, with_analyzer};
use crate::asset::{AssetId, AssetSpec, RawReference, Segment, SegmentId};
use crate::recording::{BlockEncoding, RawLayout, RecordDefaults, RecordingError, decode_block, decode_raw, decode_wav};
use crate::signal::{Condition, OperatingPoint, Record};
use crate::store::{Analysed, NewSegment, Objects};

/// How often a record is analysed again because its asset's description changed meanwhile.
const ANALYSED_AGAIN: u32 = 4;

/// How the bytes of one record are written.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RecordFormat {
    /// A WAV file.
    Wav,
    /// A `WaveformBlock` message in protobuf.
    Protobuf,
    /// A `WaveformBlock` message in JSON.
    Json,
    /// Bare samples.
    Raw(RawLayout),
}

/// What the sender says of a record beside its bytes; the bytes' own word counts first.
#[derive(Debug, Clone, Default)]
pub struct Given {
    /// The time of the first sample; the time of receipt where nobody says.
    pub start_time: Option<Timestamp>,
    /// The channel's name, for a recording of one channel.
    pub channel: Option<String>,
    /// The channels' names in their order, for a recording of several; empty where it says itself or does not matter.
    pub channel_names: Vec<String>,
    /// Unit of the samples.
    pub unit: Option<String>,
    /// Operating point.
    pub operating_point: OperatingPoint,
    /// Wear depth in µm known from elsewhere.
    pub reference_wear_um: Option<f64>,
}

impl RecordFormat {
    /// The media type of such bytes, with everything that is needed to read them.
    pub fn media_type(self) -> String {
        match self {
            Self::Wav => "audio/wav".to_string(),
            Self::Protobuf => "application/x-protobuf".to_string(),
            Self::Json => "application/json".to_string(),
            Self::Raw(layout) => layout.to_string(),
        }
    }

    /// The format of a media type: without parameters, or one of bare samples as [`media_type`](Self::media_type) wrote it.
    pub fn from_media_type(media_type: &str) -> Option<Self> {
        match media_type {
            "audio/wav" | "audio/x-wav" | "audio/wave" | "audio/vnd.wave" => Some(Self::Wav),
            "application/x-protobuf" | "application/protobuf" => Some(Self::Protobuf),
            "application/json" => Some(Self::Json),
            _ => RawLayout::from_media_type(media_type).map(Self::Raw),
        }
    }

    pub(super) fn of_block(encoding: BlockEncoding) -> Self {
        match encoding {
            BlockEncoding::Protobuf => Self::Protobuf,
            BlockEncoding::Json => Self::Json,
        }
    }

    /// The records in the bytes, one for each channel.
    pub(super) fn decode(self, bytes: &[u8], defaults: &RecordDefaults) -> Result<Vec<Record>, RecordingError> {
        match self {
            Self::Wav => decode_wav(bytes, defaults),
            Self::Protobuf => Ok(vec![decode_block(bytes, BlockEncoding::Protobuf, defaults)?]),
            Self::Json => Ok(vec![decode_block(bytes, BlockEncoding::Json, defaults)?]),
            Self::Raw(layout) => decode_raw(bytes, layout, defaults),
        }
    }
}

/// What became of a record that was taken.
#[derive(Debug, Clone, PartialEq)]
pub enum Accepted {
    /// It is stored, now or since before.
    Stored(Box<Segment>),
    /// Its raw bytes are kept, and it was handed over to be analysed.
    Queued(Box<QueuedRecord>),
}

impl Accepted {
    /// Which channel of its recording it is, counted from 0.
    pub fn channel_index(&self) -> u32 {
        match self {
            Self::Stored(segment) => segment.raw.channel_index,
            Self::Queued(record) => record.raw.channel_index,
        }
    }
}

/// A record with its name and its raw bytes' name, before anything is kept.
pub(super) struct Named {
    pub(super) id: SegmentId,
    pub(super) record: Arc<Record>,
    pub(super) raw: RawReference,
    pub(super) reference_wear_um: Option<f64>,
}

/// Records that are analysed and whose raw bytes are on the disk: what is left is their rows.
pub(super) struct Kept<'a> {
    spec: AssetSpec,
    named: Arc<Vec<Named>>,
    analysed: Vec<NewSegment>,
    received_at: Timestamp,
    raw: KeptRaw,
    _keeping: RwLockReadGuard<'a, ()>,
}

impl Named {
    /// Names a record; refuses what cannot be stored or addressed.
    pub(super) fn new(asset: &AssetId, record: Record, raw: RawReference, reference_wear_um: Option<f64>) -> Result<Self, IngestError> {
        let channel = record.channel();
        if channel.is_empty() || channel.len() > 200 || channel.chars().any(char::is_control) {
            return Err(IngestError::Field {
                field: "channel",
                value: format!("{channel:?}"),
                expected: "a name of 1 to 200 bytes without control characters",
            });
        }
        if record.unit().contains('\0') {
            return Err(IngestError::Field {
                field: "unit",
                value: format!("{:?}", record.unit()),
                expected: "a text without NUL characters",
            });
        }
        if i64::try_from(record.start_time().as_nanosecond()).is_err() {
            return Err(IngestError::Field {
                field: "start_time",
                value: record.start_time().to_string(),
                expected: "a time from 1677-09-21 to 2262-04-11",
            });
        }
        if let Some(wear) = reference_wear_um
            && !(wear >= 0.0 && wear.is_finite())
        {
            return Err(IngestError::Field {
                field: "reference_wear_um",
                value: wear.to_string(),
                expected: "a finite depth of at least 0",
            });
        }
        Ok(Self {
            id: SegmentId::derive(asset, channel, record.start_time(), &raw),
            record: Arc::new(record),
            raw,
            reference_wear_um,
        })
    }

    /// One that is stored for another asset, as `asset` hears it.
    pub(super) fn of_stored(asset: &AssetId, record: Record, raw: RawReference) -> Self {
        Self {
            id: SegmentId::derive(asset, record.channel(), record.start_time(), &raw),
            record: Arc::new(record),
            raw,
            reference_wear_um: None,
        }
    }

    /// The same record as another asset hears it; a depth that is known is not that of its mesh.
    pub(super) fn heard_by(&self, listener: &AssetSpec) -> Self {
        Self {
            id: SegmentId::derive(&listener.id, self.record.channel(), self.record.start_time(), &self.raw),
            record: Arc::clone(&self.record),
            raw: self.raw.clone(),
            reference_wear_um: None,
        }
    }

    fn samples(&self) -> usize {
        self.record.samples().len()
    }

    /// The segment of the record, with everything that the record says by itself. To be called on a worker thread.
    fn analyse(&self, spec: &AssetSpec, received_at: Timestamp) -> NewSegment {
        let record = &self.record;
        NewSegment {
            id: self.id.clone(),
            asset_id: spec.id.clone(),
            channel: record.channel().to_string(),
            start_time: record.start_time(),
            received_at,
            sample_rate_hz: record.sample_rate_hz(),
            samples: self.samples() as u64,
            unit: record.unit().to_string(),
            operating_point: record.operating_point(),
            reference_wear_um: self.reference_wear_um,
            raw: self.raw.clone(),
            analysed: analyse(record, spec),
        }
    }
}

/// Everything that a record says by itself. To be called on a worker thread.
pub(super) fn analyse(record: &Record, spec: &AssetSpec) -> Analysed {
    let Condition { analysis, basis } = with_analyzer(record.samples().len(), |analyzer| {
        analyzer.condition(&spec.seen_from_shaft(record), &spec.condition_settings())
    });
    Analysed {
        keys: analysis_keys(spec),
        shaft_speed: analysis.shaft_speed,
        basis,
        indicators: analysis.indicators,
        features: analysis.features,
    }
}

impl Ingest {
    /// Takes the bytes of one record (or of one recording of several channels), and answers once everything is on the disk; where others
    /// analyse, once the bytes are kept and the record is handed over.
    ///
    /// Returns what became of each channel, in the order of the channels. A repeat is answered with what is stored.
    pub async fn accept(
        &self,
        asset: &AssetId,
        format: RecordFormat,
        bytes: Bytes,
        given: Given,
        ticket: Ticket,
    ) -> Result<Vec<Accepted>, IngestError> {
        // A client that hangs up must not leave half of the work: it goes on by itself.
        let (ingest, asset) = (self.clone(), asset.clone());
        let task = tokio::spawn(async move {
            let _ticket = ticket;
            let answer = ingest.accept_here(&asset, format, bytes, given).await;
            if matches!(answer, Err(IngestError::Recording(_) | IngestError::Field { .. })) {
                ingest.count(0, 0, 1);
            }
            answer
        });
        task.await.map_err(|_| IngestError::WorkerLost("take a record"))?
    }

    async fn accept_here(&self, asset: &AssetId, format: RecordFormat, bytes: Bytes, given: Given) -> Result<Vec<Accepted>, IngestError> {
        let Hearers { asset, listeners } = self.hearers(asset).await?;
        let spec = asset.spec.clone();
        let received_at = self.inner.clock.now();
        let named = {
            let (spec, bytes) = (spec.clone(), bytes.clone());
            let decode = move || decode_and_name(&spec, format, &bytes, &given, received_at);
            self.inner.workers.run("decode a record", decode).await??
        };
        let mut known = self.known_to_all(&named.iter().collect::<Vec<_>>(), &listeners).await?;
        if known.len() == named.len() {
            known.sort_by_key(|segment| segment.raw.channel_index);
            self.count(0, known.len(), 0);
            return Ok(known.into_iter().map(|segment| Accepted::Stored(Box::new(segment))).collect());
        }
        if let Part::Entrance(crew) = &self.inner.part {
            return self.hand_over(crew, &asset, named, bytes, known, received_at).await;
        }
        // Before anything is kept: a record that has to come again leaves nothing behind.
        self.libraries_are_there(&spec, &listeners).await?;
        let name = named.first().map(|named| named.raw.sha256.clone()).unwrap_or_default();
        let kept = self.analyse_and_keep(spec, named, vec![(name, bytes)], received_at).await?;
        let stored = self.store_kept(kept).await?;
        let repeated = stored.iter().filter(|stored| stored.repeated).count();
        self.count(stored.len() - repeated, repeated, 0);
        let accepted = stored.into_iter().map(|Stored { segment, .. }| Accepted::Stored(Box::new(segment)));
        Ok(accepted.collect())
    }

    /// Keeps raw bytes while their records are analysed. No object is removed as one without a record before what is returned is stored or
    /// dropped.
    pub(super) async fn analyse_and_keep(
        &self,
        spec: AssetSpec,
        named: Vec<Named>,
        raws: Vec<(String, Bytes)>,
        received_at: Timestamp,
    ) -> Result<Kept<'_>, IngestError> {
        let keeping = self.inner.keeping.read().await;
        let raw = KeptRaw::new(self, raws.iter().map(|(name, _)| name.clone()).collect());
        let ingest = self.clone();
        let keep = tokio::spawn(async move { ingest.keep_raw(raws).await });
        let named = Arc::new(named);
        let analysed = self.analyse(&spec, &named, received_at).await;
        keep.await.map_err(|_| IngestError::WorkerLost("keep records"))??;
        Ok(Kept {
            spec,
            named,
            analysed: analysed?,
            received_at,
            raw,
            _keeping: keeping,
        })
    }

    /// Analyses records whose raw bytes are kept already.
    pub(super) async fn analyse_kept(&self, spec: AssetSpec, named: Vec<Named>, received_at: Timestamp) -> Result<Kept<'_>, IngestError> {
        let keeping = self.inner.keeping.read().await;
        let named = Arc::new(named);
        let analysed = self.analyse(&spec, &named, received_at).await?;
        Ok(Kept {
            spec,
            named,
            analysed,
            received_at,
            raw: KeptRaw::new(self, Vec::new()),
            _keeping: keeping,
        })
    }

    /// Keeps raw bytes under their names; they are safe once this returns.
    pub(super) async fn keep_raw(&self, raws: Vec<(String, Bytes)>) -> Result<(), IngestError> {
        let store = self.inner.store.clone();
        let kept = tokio::task::spawn_blocking(move || store.objects().put_all(&raws)).await;
        Ok(kept.map_err(|_| IngestError::WorkerLost("keep records"))??)
    }

    /// Stores the segments of what is kept. Answers in the order given.
    pub(super) async fn store_kept(&self, kept: Kept<'_>) -> Result<Vec<Stored>, IngestError> {
        let Kept {
            spec,
            named,
            analysed,
            received_at,
            raw,
            _keeping,
        } = kept;
        let of = spec.id.clone();
        let stored = self.store_analysed(spec, &named, analysed, received_at).await?;
        raw.are_stored();
        if stored.iter().any(|stored| stored.is_heard) {
            self.let_hear(&of, &named, received_at).await?;
        }
        Ok(stored)
    }

    /// Stores segments that are analysed; where the asset's description changed meanwhile, they are analysed again.
    pub(super) async fn store_analysed(
        &self,
        mut spec: AssetSpec,
        named: &Arc<Vec<Named>>,
        mut analysed: Vec<NewSegment>,
        received_at: Timestamp,
    ) -> Result<Vec<Stored>, IngestError> {
        let mut tries = 0;
        loop {
            match self.store_segments(&spec.id, analysed).await {
                Err(IngestError::DescriptionChanged(_)) if tries < ANALYSED_AGAIN => tries += 1,
                done => return done,
            }
            spec = self.asset_spec(&spec.id).await?;
            self.inner.libraries.tracker(&spec).await?;
            analysed = self.analyse(&spec, named, received_at).await?;
        }
    }

    /// Waits for the libraries of an asset and of those that hear through it.
    pub(super) async fn libraries_are_there(&self, spec: &AssetSpec, listeners: &[AssetSpec]) -> Result<(), IngestError> {
        for spec in std::iter::once(spec).chain(listeners) {
            self.inner.libraries.tracker(spec).await?;
        }
        Ok(())
    }

    pub(super) async fn analyse(
        &self,
        spec: &AssetSpec,
        named: &Arc<Vec<Named>>,
        received_at: Timestamp,
    ) -> Result<Vec<NewSegment>, IngestError> {
        const TASK: &str = "analyse records";
        let workers = &self.inner.workers;
        let ordinary = {
            let (spec, named) = (spec.clone(), Arc::clone(named));
            let analyse = move |named: &Named| (!is_large(named.samples())).then(|| named.analyse(&spec, received_at));
            move || named.par_iter().map(analyse).collect::<Vec<_>>()
        };
        let mut analysed = Vec::with_capacity(named.len());
        for (n, segment) in workers.run(TASK, ordinary).await?.into_iter().enumerate() {
            if let Some(segment) = segment {
                analysed.push(segment);
                continue;
            }
            // The large ones one after the other: there may not be the memory for two.
            let (spec, of) = (spec.clone(), Arc::clone(named));
            let large = move || of[n].analyse(&spec, received_at);
            analysed.push(workers.run_analysis(TASK, named[n].samples(), large).await?);
        }
        Ok(analysed)
    }

    pub(super) fn count_queued(&self, queued: usize) {
        self.inner
            .tally
            .queued
            .fetch_add(queued as u64, std::sync::atomic::Ordering::Relaxed);
    }

    pub(super) fn count(&self, stored: usize, repeated: usize, refused: usize) {
        use std::sync::atomic::Ordering::Relaxed;
        let tally = &self.inner.tally;
        tally.stored.fetch_add(stored as u64, Relaxed);
        tally.repeated.fetch_add(repeated as u64, Relaxed);
        tally.refused.fetch_add(refused as u64, Relaxed);
    }
}

/// What holds for an asset's records where they do not say.
pub(super) fn defaults_of(spec: &AssetSpec, start_time: Timestamp) -> RecordDefaults {
    RecordDefaults {
        channel: spec.sensor.channel.clone(),
        start_time,
        unit: spec.sensor.unit.clone(),
        channel_units: spec.channel_units(),
        ..RecordDefaults::default()
    }
}

fn decode_and_name(
    spec: &AssetSpec,
    format: RecordFormat,
    bytes: &[u8],
    given: &Given,
    received_at: Timestamp,
) -> Result<Vec<Named>, IngestError> {
    let mut defaults = RecordDefaults {
        channel: given.channel.clone(),
        channel_names: given.channel_names.clone(),
        operating_point: given.operating_point,
        ..defaults_of(spec, given.start_time.unwrap_or(received_at))
    };
    if given.unit.is_some() {
        defaults.unit.clone_from(&given.unit);
        defaults.channel_units.clear();
    }
    let records = format.decode(bytes, &defaults)?;
    let names = &given.channel_names;
    if !names.is_empty() {
        if names.len() != records.len() {
            return Err(IngestError::Field {
                field: "channel_names",
                value: format!("{names:?}"),
                expected: "as many names as the recording has channels",
            });
        }
        if (1..names.len()).any(|n| names[..n].contains(&names[n])) {
            return Err(IngestError::Field {
                field: "channel_names",
                value: format!("{names:?}"),
                expected: "every name once",
            });
        }
    }
    let sha256 = Objects::name(bytes);
    let named = (0..).zip(records).map(|(channel_index, record)| {
        let raw = RawReference {
            sha256: sha256.clone(),
            bytes: bytes.len() as u64,
            media_type: format.media_type(),
            channel_index,
        };
        Named::new(&spec.id, record, raw, given.reference_wear_um)
    });
    named.collect()
}
