use std::collections::BTreeMap;
use std::io::Cursor;

use jiff::Timestamp;
use proptest::prelude::*;

use super::*;
use flankwatch_signal::{OperatingPoint, Quality};

fn record(channel: &str, second: i64, samples: Vec<f32>) -> Record {
    Record::new(channel, Timestamp::from_second(second).unwrap(), 100.0, "m/s2", samples)
        .unwrap()
        .with_operating_point(OperatingPoint { shaft_speed_hz: Some(29.7), ..OperatingPoint::default() })
        .unwrap()
}

fn written(compression: McapCompression, records: &[Record]) -> Vec<u8> {
    let mut writer = McapWriter::new(Cursor::new(Vec::new()), McapOptions { compression }).unwrap();
    let wear = BTreeMap::from([("1000000000".to_owned(), "12.5".to_owned())]);
    writer.metadata(REFERENCE_WEAR, wear).unwrap();
    for record in records {
        writer.write(&format!("/pump/{}/waveform", record.channel()), record).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

#[test]
fn records_come_back_from_mcap_with_every_compression() {
    let noise: Vec<f32> = (0..400_000_u32).map(|k| (k.wrapping_mul(2_654_435_761) >> 8) as f32).collect();
    let records = [
        record("gearbox/x", 1, vec![1.0, -0.0, f32::MIN_POSITIVE / 4.0, f32::MAX]),
        record("y", 1, noise),
        // Four seconds after the end of the channel's first one, as the writer notes.
        record("gearbox/x", 5, vec![2.0]).with_quality(Quality { clipped: false, gap: true }),
    ];
    for compression in [McapCompression::Zstd, McapCompression::Lz4, McapCompression::None] {
        let bytes = written(compression, &records);
        let read: Vec<Recorded> = McapReader::new(Cursor::new(bytes)).map(Result::unwrap).collect();
        assert_eq!(read.iter().map(|r| r.record.clone()).collect::<Vec<_>>(), records);
        let wear: Vec<Option<f64>> = read.iter().map(|r| r.reference_wear_um).collect();
        assert_eq!(wear, [Some(12.5), Some(12.5), None]);
    }
}

#[test]
fn a_written_mcap_is_chunked_indexed_and_numbered() {
    let records = [record("x", 1, vec![0.0; 100]), record("x", 2, vec![0.0; 100]), record("x", 9, vec![1.0])];
    let bytes = written(McapCompression::Zstd, &records);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let statistics = summary.stats.unwrap();
    assert_eq!((statistics.message_count, statistics.metadata_count, statistics.chunk_count), (3, 1, 1));
    let schema = summary.schemas.values().next().unwrap();
    assert_eq!((schema.name.as_str(), schema.encoding.as_str()), ("flankwatch.v1.WaveformBlock", "protobuf"));
    let messages: Vec<mcap::Message<'_>> =
        mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
    let times: Vec<(u64, u64, u32)> =
        messages.iter().map(|m| (m.log_time, m.publish_time, m.sequence)).collect();
    let second = 1_000_000_000;
    assert_eq!(times, [(second, second, 1), (2 * second, 2 * second, 2), (9 * second, 9 * second, 3)]);
    let blocks: Vec<message::WaveformBlock> =
        messages.iter().map(|m| prost::Message::decode(&*m.data).unwrap()).collect();
    assert_eq!(blocks.iter().map(|b| b.first_sample_index).collect::<Vec<_>>(), [0, 100, 800]);
    assert_eq!(blocks.iter().map(|b| b.quality.is_some()).collect::<Vec<_>>(), [false, false, true]);
}

#[test]
fn a_drifting_clock_is_no_gap() {
    let starting_at = |ns: i128| {
        Record::new("x", Timestamp::from_nanosecond(ns).unwrap(), 20_000.0, "g", vec![0.5; 20_000]).unwrap()
    };
    // The clock of the samples runs 0.01 % fast; then 50 ms are missing.
    let second_ns = 1_000_100_000;
    let mut records: Vec<Record> = (0..100).map(|k| starting_at(k * second_ns)).collect();
    records.push(starting_at(100 * second_ns + 50_000_000));
    let bytes = written(McapCompression::None, &records);
    let blocks: Vec<message::WaveformBlock> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(|item| prost::Message::decode(&*item.unwrap().data).unwrap())
        .collect();
    for (k, block) in (0..100).zip(&blocks) {
        assert_eq!((block.first_sample_index, block.quality.is_some()), (k * 20_000, false));
    }
    assert_eq!(blocks[100].first_sample_index, 100 * 20_000 + 1002);
    assert!(blocks[100].quality.is_some_and(|quality| quality.gap));
}

#[test]
fn a_live_record_keeps_both_its_times() {
    let mut writer =
        McapWriter::new(Cursor::new(Vec::new()), McapOptions { compression: McapCompression::Lz4 }).unwrap();
    let received = Timestamp::from_second(8).unwrap();
    writer.write_received("/a/x/waveform", &record("x", 5, vec![0.0]), received).unwrap();
    let bytes = writer.finish().unwrap().into_inner();
    let message = mcap::MessageStream::new(&bytes).unwrap().next().unwrap().unwrap();
    assert_eq!((message.log_time, message.publish_time), (8_000_000_000, 5_000_000_000));
}

#[test]
fn a_time_before_1970_is_rejected_by_mcap() {
    let mut writer = McapWriter::new(Cursor::new(Vec::new()), McapOptions::default()).unwrap();
    let error = writer.write("/a/x/waveform", &record("x", -1, vec![0.0])).unwrap_err().to_string();
    assert!(error.contains("start_time is 1969-12-31T23:59:59Z"), "{error}");
}

fn wav(frames: &[[f32; 2]], rate: f64) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = WavWriter::new(&mut bytes, 2, rate).unwrap();
    for frame in frames {
        writer.write_frame(frame).unwrap();
    }
    writer.finish().unwrap();
    bytes.into_inner()
}

proptest! {
    #[test]
    fn frames_come_back_from_wav(frames in prop::collection::vec([-1e9f32..1e9, -1.0f32..1.0], 1..100)) {
        let records = decode_wav(&wav(&frames, 12_800.0), &RecordDefaults::default()).unwrap();
        for (k, record) in records.iter().enumerate() {
            prop_assert_eq!(record.channel(), (k + 1).to_string());
            prop_assert_eq!(record.sample_rate_hz(), 12_800.0);
            let expected: Vec<f32> = frames.iter().map(|frame| frame[k]).collect();
            prop_assert_eq!(record.samples(), &expected[..]);
        }
    }

    #[test]
    fn arbitrary_bytes_never_panic(
        tag in prop_oneof![Just(&b"RIFF\0\0\0\0WAVEfmt "[..]), Just(&b"RIFX\0\0\0\0WAVE"[..]), Just(mcap::MAGIC), Just(&b""[..])],
        rest in prop::collection::vec(prop_oneof![Just(0u8), any::<u8>()], 0..200),
    ) {
        let bytes = [tag, &rest].concat();
        let _ = decode_wav(&bytes, &RecordDefaults::default());
        McapReader::new(Cursor::new(bytes.clone())).take(300).for_each(drop);
        let _ = CsvFrames::new(&bytes[..], &[]).map(|mut frames| while let Ok(true) = frames.next_frame(&mut [0.0; 256]) {});
    }
}

#[test]
fn a_cut_wav_equals_the_whole_one() {
    let frames: Vec<[f32; 2]> = (0..102_000).map(|k| [k as f32, -(k as f32)]).collect();
    let bytes = wav(&frames, 1000.0);
    let length = bytes.len() as u64;
    let defaults = RecordDefaults::default();
    let whole = decode_wav(&bytes, &defaults).unwrap();
    let cut: Vec<Record> =
        RecordBlocks::new(WavFrames::new(&bytes[..], length).unwrap(), &defaults, Some(Cut::Seconds(7.0)))
            .unwrap()
            .map(Result::unwrap)
            .collect();
    assert_eq!(cut.len(), 30);
    for (k, channel) in whole.iter().enumerate() {
        let joined: Vec<f32> =
            cut.iter().skip(k).step_by(2).flat_map(|r| r.samples().iter().copied()).collect();
        assert_eq!(joined, channel.samples());
    }
    assert_eq!(cut[29].start_time(), Timestamp::from_second(98).unwrap());
    assert_eq!(cut[29].samples().len(), 4000);
}

#[test]
fn a_two_hour_wav_is_read_ten_seconds_at_a_time() {
    // 2 h at 20 kHz, 16 bits, generated while reading: 288 MB that are never in memory.
    let header = std::fs::read(fixture("wav-length-left-open.wav")).unwrap();
    let mut header = header[..44].to_vec();
    header[24..28].copy_from_slice(&20_000_u32.to_le_bytes());
    let data_bytes = 2 * 3600 * 20_000 * 2_u64;
    header[40..44].copy_from_slice(&u32::try_from(data_bytes).unwrap().to_le_bytes());
    let stream =
        std::io::Read::chain(Cursor::new(header), std::io::Read::take(std::io::repeat(1), data_bytes));
    let frames = WavFrames::new(stream, 44 + data_bytes).unwrap();
    let blocks = RecordBlocks::new(frames, &RecordDefaults::default(), None).unwrap();
    assert_eq!(blocks.default_cut_seconds(), Some(10.0));
    let mut count = 0;
    for record in blocks {
        let record = record.unwrap();
        assert_eq!(record.samples().len(), 200_000);
        assert_eq!(record.start_time().as_second(), 10 * count);
        count += 1;
    }
    assert_eq!(count, 720);
}

#[test]
fn a_rate_that_wav_cannot_store_is_rejected() {
    for rate in [12_800.5, 0.0, -1.0, f64::NAN, 1e10] {
        assert!(WavWriter::new(Cursor::new(Vec::new()), 1, rate).is_err(), "{rate}");
    }
    assert!(WavWriter::new(Cursor::new(Vec::new()), 0, 100.0).is_err());
}
