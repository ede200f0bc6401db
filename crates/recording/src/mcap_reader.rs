//! Reader of vibration records in MCAP recordings.

use std::collections::VecDeque;
use std::io::Read;

use super::mcap_contents::{Contents, Outcome};
use super::mcap_frames::McapFrames;
use super::pulses::end_ns;
use super::{RecordDefaults, Recorded, RecordingError};

/// Largest number of samples buffered while waiting for tachometer pulses. Beyond it the earliest record is
/// returned without the missing pulses.
const MAX_PENDING_SAMPLES: usize = 1 << 22;

/// Largest number of records buffered for the same reason.
const MAX_PENDING_RECORDS: usize = 64;

/// Largest number of raw bytes of records buffered for the same reason; they include data other than samples.
const MAX_PENDING_BYTES: usize = 128 << 20;

/// Reads the waveforms of an MCAP recording in file order, in bounded memory.
///
/// A waveform is a message of schema `flankwatch.v1.WaveformBlock` in protobuf or JSON, or any JSON message
/// on a topic that ends in `/waveform`. The record's channel is the topic `/{asset}/{channel}/waveform`
/// without its first and last part, so `/pump/gearbox/x/waveform` is `gearbox/x`; any other topic is used
/// unchanged. Messages on `/{asset}/operating_point` apply to the asset's following waveforms as far as these
/// state no operating point. Pulses on `/{asset}/tachometer` belong to the asset's waveforms of the same
/// time, before or after them in the file, unless these contain pulses or state that they have none. A
/// waveform waits for pulses past its end while at most 64 records, 4 million samples and 128 MiB are
/// waiting. The latest 4 million pulses of an asset are kept, and 8 million over all assets. A message on
/// `/{asset}/driven/tachometer` without a shaft belongs to the driven shaft and is ignored; any other word in
/// that position is a location. A start time of 0 is replaced by the message's publish time.
///
/// An invalid message is an `Err`, and reading continues. Damage is an `Err` with the byte position, and the
/// last item: the records before it are valid, those of a chunk with a wrong checksum are not used. A
/// recording without any waveform is an `Err` that lists its topics.
pub struct McapReader {
    frames: McapFrames,
    contents: Contents,
    /// Records in file order that wait for pulses, or behind one that does.
    pending: VecDeque<Pending>,
    ended: bool,
}

/// A pending item and the asset whose pulses it waits for, if any.
struct Pending {
    item: Result<Recorded, RecordingError>,
    waits_for: Option<String>,
}

impl McapReader {
    /// Creates a reader of a recording from its first byte. Nothing is read before the first record is
    /// requested.
    pub fn new(bytes: impl Read + Send + 'static) -> Self {
        Self::with_defaults(bytes, RecordDefaults::default())
    }

    /// Like [`new`](Self::new), with defaults for values that neither a block nor the recording states.
    pub fn with_defaults(bytes: impl Read + Send + 'static, defaults: RecordDefaults) -> Self {
        Self {
            frames: McapFrames::new(bytes),
            contents: Contents::new(defaults),
            pending: VecDeque::new(),
            ended: false,
        }
    }

    /// Returns the next item that is complete.
    fn ready(&mut self) -> Option<Result<Recorded, RecordingError>> {
        let first = self.pending.front()?;
        if let (Some(asset), Ok(recorded)) = (&first.waits_for, &first.item) {
            let train = self.contents.pulses.of(asset);
            let is_complete = train.is_some_and(|pulses| pulses.reaches_past(end_ns(&recorded.record)));
            let pending = self.pending.iter().flat_map(|pending| &pending.item);
            let (samples, bytes) = pending.fold((0, 0), |(samples, bytes), pending| {
                (samples + pending.record.samples().len(), bytes + pending.raw.len())
            });
            let is_full = self.pending.len() > MAX_PENDING_RECORDS
                || samples > MAX_PENDING_SAMPLES
                || bytes > MAX_PENDING_BYTES;
            if !(is_complete || is_full || self.ended) {
                return None;
            }
        }
        let Pending { item, waits_for } = self.pending.pop_front()?;
        Some(match (item, waits_for) {
            (Ok(recorded), Some(asset)) => Ok(self.contents.with_pulses(recorded, &asset)),
            (item, _) => item,
        })
    }

    fn enqueue(&mut self, item: Result<Recorded, RecordingError>, waits_for: Option<String>) {
        self.pending.push_back(Pending { item, waits_for });
    }
}

impl Iterator for McapReader {
    type Item = Result<Recorded, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(item) = self.ready() {
                return Some(item);
            }
            if self.ended {
                return None;
            }
            let contents = &mut self.contents;
            match self.frames.next_record(|opcode, data| contents.take(opcode, data)) {
                Ok(Some(Outcome::Nothing)) => {}
                Ok(Some(Outcome::Item(item))) => self.enqueue(item, None),
                Ok(Some(Outcome::Waiting(recorded, asset))) => self.enqueue(Ok(recorded), Some(asset)),
                Ok(Some(Outcome::Damage(what))) => {
                    self.ended = true;
                    let byte = self.frames.record_start();
                    self.enqueue(Err(RecordingError::McapDamaged { byte, what }), None);
                }
                Ok(None) => {
                    self.ended = true;
                    if self.contents.waveforms == 0 {
                        self.enqueue(Err(self.contents.no_vibration()), None);
                    }
                }
                Err(error) => {
                    self.ended = true;
                    self.enqueue(Err(error), None);
                }
            }
        }
    }
}
