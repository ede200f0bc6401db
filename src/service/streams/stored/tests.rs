use super::*;
use crate::recording::RawSample;
use crate::recording::stream::CutPolicy;

const RATE_HZ: f64 = 100.0;

fn format() -> StreamFormat {
    StreamFormat::new(RawSample::I16, RATE_HZ, 1, None).unwrap()
}

fn policy() -> Cutting {
    CutPolicy::new(2.0, 10.0, RATE_HZ).unwrap().into()
}

fn chunk(first: u64, frames: u64) -> Chunk {
    let bytes = (first..first + frames).flat_map(|k| (k as i16).to_le_bytes()).collect();
    Chunk { first, time_ns: Some(1_760_000_000_000_000_000 + first as i64 * 10_000_000), bytes }
}

fn stream(folder: &Path) -> StoredStream {
    let location = StreamLocation::in_folder(folder);
    StoredStream::create(&location, Timestamp::UNIX_EPOCH, format(), Some(0)).unwrap()
}

#[test]
fn a_killed_stream_resumes_with_the_same_records() {
    let chunks: Vec<Chunk> = (0..60).filter(|k| *k != 22).map(|k| chunk(k * 50, 50)).collect();
    let folder = tempfile::tempdir().unwrap();
    let mut whole = stream(folder.path());
    for chunk in &chunks {
        whole.take(vec![chunk.clone()], &policy()).unwrap();
    }
    let firsts: Vec<u64> = whole.state.pending.iter().map(|pending| pending.cut.first).collect();
    assert_eq!(firsts, [0, 1150, 2000]);
    assert_eq!((whole.state.gaps, whole.state.gap_samples, whole.state.next), (1, 50, Some(3000)));
    let levels = whole.levels(i64::MIN, i64::MAX).unwrap();
    assert_eq!((levels.len(), levels[11].level.frames), (30, 50));

    let folder = tempfile::tempdir().unwrap();
    let mut killed = stream(folder.path());
    for (n, chunk) in chunks.iter().enumerate() {
        killed.take(vec![chunk.clone()], &policy()).unwrap();
        drop(killed);
        if n % 3 == 0 {
            // An entry that was being written.
            let newest = std::fs::read_dir(folder.path()).unwrap().flatten().map(|entry| entry.path());
            let newest = newest.filter(|path| path.extension().is_some()).max().unwrap();
            let mut bytes = std::fs::read(&newest).unwrap();
            bytes.extend_from_slice(&[120, 0, 0, 0, 1, 2, 3, 4, 2, 9]);
            std::fs::write(&newest, bytes).unwrap();
        }
        killed = StoredStream::open(&StreamLocation::in_folder(folder.path())).unwrap().unwrap();
        // Chunks that waited for earlier ones are sent again.
        let next = killed.state.next.unwrap_or(0);
        let again: Vec<Chunk> = chunks[..=n].iter().filter(|chunk| chunk.first >= next).cloned().collect();
        killed.take(again, &policy()).unwrap();
    }
    assert_eq!(killed.state.pending, whole.state.pending);
    assert_eq!(killed.levels(i64::MIN, i64::MAX).unwrap(), levels);
    for pending in &whole.state.pending {
        let bytes = killed.bytes_of(pending.cut, 0).unwrap().unwrap();
        assert_eq!(bytes, chunk(pending.cut.first, pending.cut.frames).bytes);
    }
}

#[test]
fn a_chunk_larger_than_an_entry_of_the_journal_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let location = StreamLocation::in_folder(folder.path());
    let format = StreamFormat::new(RawSample::I16, 1e6, 3, None).unwrap();
    let policy = Cutting::from(CutPolicy::new(1.0, 1.0, 1e6).unwrap());
    let mut stream = StoredStream::create(&location, Timestamp::UNIX_EPOCH, format, Some(0)).unwrap();
    let bytes: Bytes = (0..12_000_000_u32).map(|k| (k >> 8) as u8).collect();
    stream.take(vec![Chunk { first: 0, time_ns: Some(0), bytes: bytes.clone() }], &policy).unwrap();
    stream.take(vec![Chunk { first: 2_000_000, time_ns: None, bytes: vec![1; 6].into() }], &policy).unwrap();
    drop(stream);
    let stream = StoredStream::open(&location).unwrap().unwrap();
    assert_eq!((stream.state.next, stream.state.pending.len()), (Some(2_000_001), 2));
    let cut = stream.state.pending[1].cut;
    assert!(stream.bytes_of(cut, 0).unwrap().unwrap() == bytes.slice(6_000_000..));
}

#[test]
fn only_samples_needed_by_records_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let format = StreamFormat::new(RawSample::F32, 10_000.0, 4, None).unwrap();
    let policy = Cutting::from(CutPolicy::new(1.0, 30.0, 10_000.0).unwrap());
    let location = StreamLocation::in_folder(folder.path());
    let mut stream = StoredStream::create(&location, Timestamp::UNIX_EPOCH, format, Some(0)).unwrap();
    let second = |k: u64| Chunk {
        first: k * 10_000,
        time_ns: Some(k as i64 * 1_000_000_000),
        bytes: vec![k as u8; 160_000].into(),
    };
    let mut most = 0;
    for k in 0..300 {
        stream.take(vec![second(k)], &policy).unwrap();
        if k >= 60 {
            while let Some(pending) = stream.state.pending.front().cloned() {
                assert!(stream.bytes_of(pending.cut, 0).unwrap().is_some());
                stream.finish_record(&pending, None).unwrap();
            }
            most = most.max(stream.journal_bytes().unwrap());
        }
    }
    assert_eq!((stream.state.records, stream.state.pending.len()), (10, 0));
    // A minute is 9.6 MB; files are removed as a whole.
    assert!(most < 20 << 20, "{most}");
    let kept = stream.keep_last(5 * 10_000).unwrap().unwrap();
    assert_eq!((kept.cut.first, kept.cut.frames), (295 * 10_000, 50_000));
}

/// Processes on the rows of one store, with an asset `pump`.
fn processes<const N: usize>(folder: &Path) -> (tokio::runtime::Runtime, [StreamLocation; N]) {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build();
    let runtime = runtime.unwrap();
    let _entered = runtime.enter();
    let spec = toml::from_str("id = \"pump\"\nshaft = { speed_hz = 10.0 }").unwrap();
    let store = runtime.block_on(async {
        let store = crate::store::Store::open(&folder.into()).await.unwrap();
        store.insert_asset(&spec, None, Timestamp::UNIX_EPOCH).await.unwrap();
        store
    });
    let locations = std::array::from_fn(|_| {
        let clock = Arc::new(crate::service::SystemClock);
        let rows = Arc::new(super::super::location::SharedRows::new(store.clone(), clock));
        StreamLocation::Shared { rows, asset: spec.id.clone(), name: "main".to_owned() }
    });
    (runtime, locations)
}

#[test]
fn a_stream_that_moves_between_processes_has_the_records_of_one() {
    let (data, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let mut whole = stream(folder.path());
    let (_runtime, locations) = processes::<2>(data.path());
    let create = |location| StoredStream::create(location, Timestamp::UNIX_EPOCH, format(), Some(0)).unwrap();
    let [mut first, mut second] = [create(&locations[0]), create(&locations[1])];
    // More than a checkpoint's worth of appends, by each in turn for a while.
    for k in 0..400 {
        let chunk = chunk(k * 10, 10);
        whole.take(vec![chunk.clone()], &policy()).unwrap();
        if k % 100 == 0 {
            let sender = if k % 200 == 0 { &mut first } else { &mut second };
            assert!(sender.refresh().unwrap());
            sender.begin_sending(k).unwrap();
            sender.drop_waiting_chunks();
        }
        let (sender, other) =
            if k % 200 < 100 { (&mut first, &mut second) } else { (&mut second, &mut first) };
        sender.take(vec![chunk], &policy()).unwrap();
        if k % 150 == 149 {
            // From the state of some appends ago.
            whole.keep_last(77).unwrap().unwrap();
            assert!(other.refresh().unwrap());
            other.keep_last(77).unwrap().unwrap();
        }
        if k % 120 == 119 {
            let pending = whole.state.pending.front().cloned().unwrap();
            whole.finish_record(&pending, None).unwrap();
            // Stored by both: it counts once.
            first.finish_record(&pending, None).unwrap();
            second.finish_record(&pending, None).unwrap();
        }
    }
    let read = StoredStream::open(&locations[0]).unwrap().unwrap();
    for stored in [&mut first, &mut second] {
        assert!(stored.refresh().unwrap());
        assert_eq!(stored.state.pending, whole.state.pending);
        assert_eq!((stored.state.next, stored.state.records), (Some(4000), 3));
    }
    let levels = whole.levels(i64::MIN, i64::MAX).unwrap();
    assert_eq!(levels.len(), 40);
    for stored in [&first, &second, &read] {
        assert_eq!(stored.levels(i64::MIN, i64::MAX).unwrap(), levels);
        assert_eq!(
            stored.levels(levels[3].time_ns, levels[30].time_ns).unwrap(),
            levels[3..=30],
            "those of a time range"
        );
    }
    for pending in &whole.state.pending {
        let bytes = read.bytes_of(pending.cut, 0).unwrap().unwrap();
        assert_eq!(bytes, chunk(pending.cut.first, pending.cut.frames).bytes);
    }
}

#[test]
fn a_sender_replaced_by_one_of_another_process_stores_nothing() {
    let data = tempfile::tempdir().unwrap();
    let (_runtime, locations) = processes::<2>(data.path());
    let create = |location| StoredStream::create(location, Timestamp::UNIX_EPOCH, format(), None).unwrap();
    let [mut old, mut new] = [create(&locations[0]), create(&locations[1])];
    old.begin_sending(1).unwrap();
    old.take(vec![chunk(0, 10)], &policy()).unwrap();
    assert!(new.refresh().unwrap());
    new.begin_sending(2).unwrap();
    let error = old.take(vec![chunk(10, 10)], &policy()).unwrap_err();
    assert!(matches!(error, ServiceError::StreamTaken), "{error}");
    assert_eq!((old.state.sender, old.state.next), (Some(2), Some(10)));
    new.take(vec![chunk(10, 20)], &policy()).unwrap();
    assert!(!old.begin_cutting().unwrap() && new.begin_cutting().unwrap());
    new.end_cutting().unwrap();
    assert!(old.begin_cutting().unwrap());
    // Its samples are those of the other, without the chunk that was not stored.
    assert!(old.refresh().unwrap());
    old.begin_sending(3).unwrap();
    old.drop_waiting_chunks();
    old.take(vec![chunk(30, 10)], &policy()).unwrap();
    let cut = StreamCut { first: 0, frames: 40, next_from: 0 };
    assert_eq!(old.bytes_of(cut, 0).unwrap().unwrap(), chunk(0, 40).bytes);
}

#[test]
fn a_process_that_goes_on_cuts_nothing_that_the_other_one_skipped() {
    let data = tempfile::tempdir().unwrap();
    let (_runtime, locations) = processes::<2>(data.path());
    let create = |location| StoredStream::create(location, Timestamp::UNIX_EPOCH, format(), Some(0)).unwrap();
    let [mut first, mut second] = [create(&locations[0]), create(&locations[1])];
    let never: Cutting = CutPolicy::new(2.0, 0.0, RATE_HZ).unwrap().into();
    first.begin_sending(1).unwrap();
    for k in 0..20 {
        first.take(vec![chunk(k * 100, 100)], &never).unwrap();
        assert!(second.refresh().unwrap());
        assert_eq!(second.state.cutter, first.state.cutter);
    }
    // Meanwhile the description wants records.
    second.begin_sending(2).unwrap();
    second.drop_waiting_chunks();
    second.take(vec![chunk(2000, 300)], &policy()).unwrap();
    let firsts: Vec<u64> = second.state.pending.iter().map(|pending| pending.cut.first).collect();
    assert_eq!(firsts, [2000]);
}
