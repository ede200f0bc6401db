//! The pulses of a tachometer's channel, however its samples arrive.

use proptest::prelude::*;

use super::*;
use crate::recording::RawSample;
use crate::recording::stream::CutPolicy;
use crate::signal::Tachometer;

const RATE_HZ: f64 = 100.0;
const END: u64 = 3000;
/// Samples that never arrive.
const GAP: std::ops::Range<u64> = 1490..1510;

fn format() -> StreamFormat {
    let format = StreamFormat::new(RawSample::I16, RATE_HZ, 2, Some(1.0)).unwrap();
    format.with_tachometer("2", 500.0, None, 3).unwrap()
}

fn policy() -> Cutting {
    CutPolicy::new(2.0, 5.0, RATE_HZ).unwrap().into()
}

/// Vibration, and a tachometer of 3 to 7 pulses a second with noise.
fn chunk(first: u64, end: u64) -> Chunk {
    let frame = |k: u64| {
        let turns = k as f64 * 0.05 + (k as f64 / 400.0).sin() * 8.0;
        let noise = (k.wrapping_mul(2_654_435_761) >> 7) % 400;
        [k as i16, ((turns.fract() * 1000.0) as u64 + noise) as i16]
    };
    let bytes = (first..end).flat_map(frame).flat_map(i16::to_le_bytes).collect();
    Chunk { first, time_ns: Some(1_760_000_000_000_000_000 + first as i64 * 10_000_000), bytes }
}

/// Takes chunks one after the other. Before those in `restarts` the stream is opened again, and everything
/// that is not stored is repeated.
fn take_all(location: &StreamLocation, chunks: &[Chunk], restarts: &[bool]) -> StoredStream {
    let mut stream = StoredStream::create(location, Timestamp::UNIX_EPOCH, format(), Some(0)).unwrap();
    for (n, chunk) in chunks.iter().enumerate() {
        if restarts[n % restarts.len()] {
            drop(stream);
            stream = StoredStream::open(location).unwrap().unwrap();
            stream.plan_records(&policy()).unwrap();
            stream.take(chunks[..n].to_vec(), &policy()).unwrap();
        }
        stream.take(vec![chunk.clone()], &policy()).unwrap();
        if stream.state.next == Some(GAP.start) {
            stream.declare_lost_before(GAP.end, &policy()).unwrap();
        }
    }
    stream
}

/// First sample and pulses of each record, and the samples without the tachometer's channel.
fn records(stream: &StoredStream) -> Vec<(u64, Tachometer, Bytes)> {
    let record = |pending: &PendingCut| {
        let bytes = stream.bytes_of(pending.cut, pending.lead).unwrap().unwrap();
        let pulses = format().pulses(&bytes, pending.lead).unwrap();
        let (_, samples) = format().without_tachometer(bytes.slice(pending.lead as usize * 4..));
        (pending.cut.first, pulses, samples)
    };
    stream.state.pending.iter().map(record).collect()
}

fn taken_at_once() -> Vec<(u64, Tachometer, Bytes)> {
    let folder = tempfile::tempdir().unwrap();
    let chunks = [chunk(0, GAP.start), chunk(GAP.end, END)];
    records(&take_all(&StreamLocation::in_folder(folder.path()), &chunks, &[false]))
}

#[test]
fn records_have_the_pulses_of_the_tachometers_channel() {
    let all = format().pulses(&chunk(0, END).bytes, 0).unwrap().pulse_times_s;
    let found = taken_at_once();
    // That of the interval with the gap begins after it, and there are no pulses before.
    assert_eq!(found.iter().map(|(first, ..)| *first).collect::<Vec<_>>(), [0, 500, 1000, 1510, 2000, 2500]);
    for (first, pulses, samples) in found {
        let expected: Bytes = (first..first + 200).flat_map(|k| (k as i16).to_le_bytes()).collect();
        assert_eq!(samples, expected);
        assert_eq!(pulses.pulses_per_revolution, 3);
        let begin_s = first as f64 / RATE_HZ;
        let lead_s = if [0, GAP.end].contains(&first) { 0.0 } else { 1.0 };
        let inside = all.iter().map(|time_s| time_s - begin_s);
        let inside: Vec<f64> = inside.filter(|time_s| (-lead_s..2.0).contains(time_s)).collect();
        // The signal has to be low once before the first pulse.
        let missing = inside.len() - pulses.pulse_times_s.len();
        assert!(missing <= 1 && inside.len() > 5, "{inside:?}, {pulses:?}");
        for (found, expected) in pulses.pulse_times_s.iter().zip(&inside[missing..]) {
            assert!((found - expected).abs() < 1e-9, "{found}, {expected}");
        }
    }
}

#[test]
fn pulses_are_refused_where_a_channel_is_the_tachometer() {
    let folder = tempfile::tempdir().unwrap();
    let location = StreamLocation::in_folder(folder.path());
    let mut stream = StoredStream::create(&location, Timestamp::UNIX_EPOCH, format(), Some(0)).unwrap();
    let error = stream.take_pulses(Pulses::new(0, &[1.0], 1).unwrap()).unwrap_err();
    assert!(error.to_string().contains("a channel of the stream is its tachometer"), "{error}");
}

#[test]
fn the_second_before_a_long_record_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let format = StreamFormat::new(RawSample::I16, 10_000.0, 2, None).unwrap();
    let format = format.with_tachometer("2", 500.0, None, 1).unwrap();
    // Longer than what is kept in any case.
    let policy = Cutting::from(CutPolicy::new(100.0, 100.0, 10_000.0).unwrap());
    let location = StreamLocation::in_folder(folder.path());
    let mut stream = StoredStream::create(&location, Timestamp::UNIX_EPOCH, format, Some(0)).unwrap();
    for second in 0..300 {
        let bytes = vec![second as u8; 40_000].into();
        stream.take(vec![Chunk { first: second * 10_000, time_ns: None, bytes }], &policy).unwrap();
        if let Some(pending) = stream.state.pending.front().cloned() {
            let bytes = stream.bytes_of(pending.cut, pending.lead).unwrap();
            let first = (pending.cut.first - pending.lead) / 10_000;
            assert_eq!(bytes.unwrap()[0], first as u8);
            assert_eq!(pending.lead, if pending.cut.first == 0 { 0 } else { 10_000 });
            stream.finish_record(&pending, None).unwrap();
        }
    }
    assert_eq!(stream.state.records, 3);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// Chunks of any size, some repeated, some before their predecessors, and restarts in between.
    #[test]
    fn pulses_do_not_depend_on_how_the_samples_arrive(
        edges in prop::collection::btree_set(1..END, 40..120),
        swapped in prop::collection::vec(any::<bool>(), 31),
        repeated in prop::collection::vec(any::<bool>(), 29),
        restarts in prop::collection::vec(prop::bool::weighted(0.1), 23),
    ) {
        // Short enough that two in the wrong order are within the time that one may wait.
        static AT_ONCE: std::sync::LazyLock<Vec<(u64, Tachometer, Bytes)>> = std::sync::LazyLock::new(taken_at_once);
        let edges = edges.into_iter().chain((0..=END).step_by(90)).chain([GAP.start, GAP.end]);
        let edges: std::collections::BTreeSet<u64> = edges.filter(|k| *k == GAP.start || !GAP.contains(k)).collect();
        let edges: Vec<u64> = edges.into_iter().collect();
        let mut chunks: Vec<Chunk> = edges.windows(2).map(|edge| chunk(edge[0], edge[1])).collect();
        chunks.retain(|chunk| chunk.first != GAP.start);
        let mut n = 1;
        while n < chunks.len() {
            // Not over the gap, which is announced between the two.
            if swapped[n % swapped.len()] && chunks[n].first != GAP.end {
                chunks.swap(n - 1, n);
                n += 1;
            }
            n += 1;
        }
        let mut sent = Vec::new();
        for (n, chunk) in chunks.iter().enumerate() {
            sent.push(chunk.clone());
            if repeated[n % repeated.len()] {
                sent.push(chunks[n / 2].clone());
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let stream = take_all(&StreamLocation::in_folder(folder.path()), &sent, &restarts);
        prop_assert_eq!(stream.state.gap_samples, GAP.end - GAP.start);
        prop_assert!(records(&stream) == *AT_ONCE);
    }
}
