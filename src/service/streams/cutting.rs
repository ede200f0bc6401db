//! The rules by which records are cut out of a stream: those of the asset's description, converted to frames.

use super::state::StreamState;
use crate::asset::{AssetSpec, OperatingBin, SteadySpec};
use crate::recording::RecordingError;
use crate::recording::stream::{CutPolicy, StreamCut, StreamCutter, StreamFormat};
use crate::signal::{MAX_RECORD_SAMPLES, OperatingPoint};

/// Maximum number of bytes of one record.
const MAX_RECORD_BYTES: u64 = 64 << 20;

/// Minimum length in seconds of the records of a capture.
const CAPTURED_S: f64 = 1.0;

/// The cutting rules of a stream.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Cutting {
    clocked: CutPolicy,
    /// Replaces the interval of `clocked`.
    steady: Option<SteadyCutting>,
    bins: Vec<OperatingBin>,
    /// Frames before and after an alarm that become records.
    around_alarm: Option<(u64, u64)>,
    /// Length of the records of a capture in frames.
    captured_frames: u64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct SteadyCutting {
    bounds: SteadySpec,
    for_frames: u64,
    apart_frames: u64,
}

/// A complete record, and the rule by which it is cut.
pub(super) enum Decision {
    Clocked(StreamCut),
    Steady { cut: StreamCut, bin: String, next_from: u64 },
}

impl Cutting {
    /// The rules of an asset's description.
    ///
    /// # Errors
    /// A record would be too long or too large.
    pub(crate) fn of(spec: &AssetSpec, format: &StreamFormat) -> Result<Self, RecordingError> {
        let clocked = CutPolicy::new(spec.stream.record_s, spec.stream.interval_s, format.sample_rate_hz())?;
        check_bytes(clocked.record_frames(), format)?;
        let steady = spec.stream.steady.map(|bounds| SteadyCutting {
            bounds,
            for_frames: format.frames_in(bounds.for_s),
            apart_frames: format.frames_in(bounds.at_most_every_s),
        });
        let on_alarm = spec.stream.on_alarm;
        let around_alarm =
            on_alarm.map(|around| (format.frames_in(around.before_s), format.frames_in(around.after_s)));
        // Not so short that many are pending at once.
        let max_frames = MAX_RECORD_BYTES / format.frame_bytes() as u64;
        let captured_frames = clocked
            .record_frames()
            .max(format.frames_in(CAPTURED_S))
            .min(MAX_RECORD_SAMPLES as u64)
            .min(max_frames);
        Ok(Self { clocked, steady, bins: spec.operating_bins.clone(), around_alarm, captured_frames })
    }

    /// Frames before and after an alarm that become records; `None` if all frames do anyway.
    pub(super) fn around_alarm(&self) -> Option<(u64, u64)> {
        self.around_alarm.filter(|_| !self.is_continuous())
    }

    /// Length of the records of a capture in frames.
    pub(super) fn captured_frames(&self) -> u64 {
        self.captured_frames
    }

    /// Whether all frames become records.
    pub(super) fn is_continuous(&self) -> bool {
        self.steady.is_none() && self.clocked.is_continuous()
    }

    /// The earliest first frame of the next record after a cut.
    pub(super) fn after(&self, cut: StreamCut) -> u64 {
        if self.steady.is_some() { cut.end() } else { self.clocked.after(cut) }
    }

    /// Whether a new operating point is within the bounds of the steady period and in the same operating bin.
    /// Without bounds, any change ends the period.
    pub(super) fn is_steady(&self, state: &StreamState, point: &OperatingPoint) -> bool {
        let began = state.steadiness.began_with();
        let (speed, torque) = self
            .steady
            .map_or((0.0, 0.0), |steady| (steady.bounds.speed_fraction, steady.bounds.torque_fraction));
        stays(began.shaft_speed_hz, point.shaft_speed_hz, speed)
            && stays(began.torque_nm, point.torque_nm, torque)
            && self.bin_of(began) == self.bin_of(point)
    }

    /// Skips frames at which no further record can start, so that they need not be kept.
    pub(super) fn pass_over(&self, cutter: &mut StreamCutter) {
        if self.steady.is_some() {
            // A record is cut as soon as it is complete.
            cutter.skip_before((cutter.end() + 1).saturating_sub(self.clocked.record_frames()));
        } else if self.clocked.is_disabled() {
            cutter.skip();
        }
    }

    /// The next complete record; `None` during a capture.
    pub(super) fn next_cut(&self, state: &StreamState) -> Option<Decision> {
        if state.capture.is_some() {
            return None;
        }
        match self.steady {
            Some(steady) => self.steady_cut(&steady, state),
            None => state.cutter.next_cut(&self.clocked).map(Decision::Clocked),
        }
    }

    /// A record of the remaining frames before a gap.
    pub(super) fn last_cut(&self, state: &StreamState) -> Option<StreamCut> {
        self.steady.is_none().then(|| state.cutter.last_cut(&self.clocked)).flatten()
    }

    /// A record at the end of the time for which the machine has to be steady.
    fn steady_cut(&self, steady: &SteadyCutting, state: &StreamState) -> Option<Decision> {
        let point = state.steadiness.began_with();
        if !is_running(point) {
            return None;
        }
        let (bin, frames) = (self.bin_of(point), self.clocked.record_frames());
        let settled = steady.for_frames.saturating_sub(frames);
        let begun = state.steadiness.since().max(state.cutter.run_first());
        let first = (begun + settled).max(state.cutter.earliest()).max(state.steadiness.next_of(bin));
        let cut = StreamCut { first, frames, next_from: first + frames };
        (cut.end() <= state.cutter.end()).then(|| Decision::Steady {
            cut,
            bin: bin.to_owned(),
            next_from: first + steady.apart_frames,
        })
    }

    /// The name of the operating bin; empty if there is none.
    fn bin_of(&self, point: &OperatingPoint) -> &str {
        let bin = self.bins.iter().find(|bin| bin.holds(point.shaft_speed_hz, point.torque_nm));
        bin.map_or("", |bin| bin.name.as_str())
    }
}

#[cfg(test)]
impl From<CutPolicy> for Cutting {
    fn from(clocked: CutPolicy) -> Self {
        Self {
            clocked,
            steady: None,
            bins: Vec::new(),
            around_alarm: None,
            captured_frames: clocked.record_frames(),
        }
    }
}

/// Whether the machine is known to run.
fn is_running(point: &OperatingPoint) -> bool {
    match (point.shaft_speed_hz, point.torque_nm) {
        (Some(speed_hz), _) => speed_hz != 0.0,
        (None, torque_nm) => torque_nm.is_some_and(|torque_nm| torque_nm != 0.0),
    }
}

fn stays(began: Option<f64>, now: Option<f64>, fraction: f64) -> bool {
    match (began, now) {
        (Some(began), Some(now)) => (now - began).abs() <= fraction * began.abs(),
        (began, now) => began.is_none() && now.is_none(),
    }
}

/// Returns an error if a record would exceed the maximum number of bytes.
pub(super) fn check_bytes(frames: u64, format: &StreamFormat) -> Result<(), RecordingError> {
    if frames.saturating_mul(format.frame_bytes() as u64) <= MAX_RECORD_BYTES {
        return Ok(());
    }
    let expected = format!("a length of at most {} MiB of samples of all channels", MAX_RECORD_BYTES >> 20);
    Err(RecordingError::field("record_s", format.seconds(frames), expected))
}

#[cfg(test)]
mod tests {
    use jiff::Timestamp;

    use super::*;
    use crate::recording::RawSample;
    use crate::recording::stream::Chunk;
    use crate::service::streams::location::StreamLocation;
    use crate::service::streams::stored::StoredStream;

    /// Records of 2 s of a machine that is steady for 5 s, one every 100 s of an operating bin, at 10 Hz.
    fn steady() -> Cutting {
        let bounds =
            SteadySpec { speed_fraction: 0.02, torque_fraction: 0.05, for_s: 5.0, at_most_every_s: 100.0 };
        let bin = |name: &str, range| OperatingBin {
            name: name.to_owned(),
            shaft_speed_hz: Some(range),
            torque_nm: None,
        };
        Cutting {
            clocked: CutPolicy::new(2.0, 60.0, 10.0).unwrap(),
            steady: Some(SteadyCutting { bounds, for_frames: 50, apart_frames: 1000 }),
            bins: vec![bin("slow", [5.0, 15.0]), bin("fast", [15.0, 30.0])],
            around_alarm: None,
            captured_frames: 20,
        }
    }

    fn point(shaft_speed_hz: f64, torque_nm: f64) -> OperatingPoint {
        OperatingPoint {
            shaft_speed_hz: Some(shaft_speed_hz),
            torque_nm: Some(torque_nm),
            ..OperatingPoint::default()
        }
    }

    fn chunk(first: u64, until: u64) -> Chunk {
        let bytes = vec![0; 2 * (until - first) as usize].into();
        Chunk { first, time_ns: Some(first as i64 * 100_000_000), bytes }
    }

    /// Sends samples in pieces of a length, with the operating points in `points` set before an index; the
    /// stream is reopened before every piece if `restarts`. Returns first sample, length and speed of the
    /// records.
    fn cut(
        points: &[(u64, OperatingPoint)],
        gaps: &[u64],
        piece: u64,
        restarts: bool,
    ) -> Vec<(u64, u64, f64)> {
        let folder = tempfile::tempdir().unwrap();
        let format = StreamFormat::new(RawSample::I16, 10.0, 1, None).unwrap();
        let location = StreamLocation::in_folder(folder.path());
        let mut stream = StoredStream::create(&location, Timestamp::UNIX_EPOCH, format, Some(0)).unwrap();
        let mut edges: Vec<u64> = (0..=3000 / piece).map(|n| n * piece).collect();
        edges.extend(points.iter().map(|(index, _)| *index).chain(gaps.iter().flat_map(|at| [*at, at + 1])));
        edges.sort_unstable();
        edges.dedup();
        for pair in edges.windows(2) {
            if restarts {
                drop(stream);
                stream = StoredStream::open(&location).unwrap().unwrap();
                stream.plan_records(&steady()).unwrap();
            }
            if gaps.contains(&pair[0]) {
                stream.declare_lost_before(pair[1], &steady()).unwrap();
                continue;
            }
            for (_, point) in points.iter().filter(|(index, _)| *index == pair[0]) {
                stream.set_operating_point(*point, &steady()).unwrap();
            }
            stream.take(vec![chunk(pair[0], pair[1])], &steady()).unwrap();
        }
        let pending = stream.state().pending.iter();
        pending
            .map(|pending| {
                let speed_hz = pending.operating_point.shaft_speed_hz.unwrap();
                (pending.cut.first, pending.cut.frames, speed_hz)
            })
            .collect()
    }

    #[test]
    fn steady_records_do_not_depend_on_chunks_or_restarts() {
        // Unknown; slow; slightly faster, within the bounds; faster than that; fast; standing still.
        let points = [
            (100, point(10.0, 80.0)),
            (120, point(10.15, 82.0)),
            (400, point(10.4, 82.0)),
            (700, point(20.0, 82.0)),
            (1800, point(20.0, 95.0)),
            (1840, point(20.0, 80.0)),
            (2500, point(0.0, 80.0)),
        ];
        // The last 2 s of 5 s; the slow one is cut once in 100 s, and the fast one waits for its interval
        // and, because its torque changed, for a new steady period.
        let expected = [(130, 20, 10.15), (730, 20, 20.0), (1730, 20, 20.0)];
        for piece in [13, 50, 3000] {
            for restarts in [false, true] {
                assert_eq!(cut(&points, &[], piece, restarts), expected, "{piece} {restarts}");
            }
        }
        // Samples before a gap do not count; a change during the wait starts a new steady period.
        let points = [(0, point(10.0, 80.0)), (40, point(12.0, 80.0)), (60, point(12.0, 81.0))];
        assert_eq!(cut(&points, &[80], 7, true), [(111, 20, 12.0), (1111, 20, 12.0), (2111, 20, 12.0)]);
    }

    #[test]
    fn a_stream_that_is_never_steady_needs_no_old_samples() {
        let folder = tempfile::tempdir().unwrap();
        let format = StreamFormat::new(RawSample::I16, 10_000.0, 4, None).unwrap();
        let spec = |text: &str| -> AssetSpec {
            toml::from_str(&format!("id = \"a\"\nshaft = {{ speed_hz = 10.0 }}\n{text}")).unwrap()
        };
        let cutting = Cutting::of(&spec("stream = { steady = {} }"), &format).unwrap();
        let location = StreamLocation::in_folder(folder.path());
        let mut stream = StoredStream::create(&location, Timestamp::UNIX_EPOCH, format, Some(0)).unwrap();
        for second in 0..200 {
            stream.set_operating_point(point(10.0 + second as f64, 1.0), &cutting).unwrap();
            let bytes = vec![0; 80_000].into();
            let chunk = Chunk { first: second * 10_000, time_ns: None, bytes };
            stream.take(vec![chunk], &cutting).unwrap();
        }
        assert!(stream.state().pending.is_empty());
        // A minute is 4.8 MB; files are removed as a whole.
        assert!(stream.journal_bytes().unwrap() < 14 << 20);
    }
}
