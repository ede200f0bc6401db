use std::fs;
use std::io::Read;

use clap::Parser;
use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;

use super::*;
use crate::recording::RecordingFile;
use crate::signal::Record;

#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    convert: ConvertArgs,
}

/// A temporary folder with an input file.
struct Folder(tempfile::TempDir);

impl Folder {
    fn with_file(name: &str, bytes: &[u8]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(name), bytes).unwrap();
        Self(folder)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn convert(&self, input: &str, output: &str, options: &str) -> Result<(), String> {
        let names = input.split_whitespace().chain([output]);
        let paths: Vec<String> = names.map(|name| self.path(name).to_str().unwrap().to_owned()).collect();
        let words = ["convert"].into_iter().chain(paths.iter().map(String::as_str));
        let cli = Cli::parse_from(words.chain(options.split_whitespace()));
        run(&cli.convert).map_err(|error| error.to_string())
    }

    fn records(&self, name: &str) -> Vec<Record> {
        RecordingFile::open(self.path(name), RecordDefaults::default(), None)
            .unwrap()
            .map(|item| item.unwrap().record)
            .collect()
    }

    fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(self.0.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }
}

#[test]
fn csv_to_mcap_keeps_samples_names_and_operating_point() {
    let folder = Folder::with_file("in.csv", b"no,a1,a2\n0,1.5,2\n1,-3e-5,4\n2,0.1,6\n");
    let options = "--rate 12800.5 --unit m/s2 --asset rig --channels a2,a1 --start-time 2026-01-02T03:04:05.5Z --shaft-speed-hz 29.7 --torque-nm -3";
    folder.convert("in.csv", "out.mcap", options).unwrap();
    let records = folder.records("out.mcap");
    assert_eq!(records.iter().map(Record::channel).collect::<Vec<_>>(), ["a2", "a1"]);
    assert_eq!(records[1].samples(), [1.5, -3e-5, 0.1]);
    assert_eq!((records[0].sample_rate_hz(), records[0].unit()), (12_800.5, "m/s2"));
    assert_eq!(records[0].start_time().to_string(), "2026-01-02T03:04:05.5Z");
    let point = records[0].operating_point();
    assert_eq!((point.shaft_speed_hz, point.torque_nm), (Some(29.7), Some(-3.0)));
    assert_eq!(folder.names(), ["in.csv", "out.mcap"]);
}

#[test]
fn rate_unit_and_start_time_of_the_file_are_used() {
    let text = "Messung;7\nwhen;a\n;m/s2\n01.03.2026 08:00:00,000;1,5\n01.03.2026 08:00:00,010;2,5\n";
    let folder = Folder::with_file("in.csv", text.as_bytes());
    folder.convert("in.csv", "out.mcap", "").unwrap();
    let record = folder.records("out.mcap").remove(0);
    assert_eq!((record.samples(), record.unit(), record.sample_rate_hz()), (&[1.5, 2.5][..], "m/s2", 100.0));
    assert_eq!(record.start_time().to_string(), "2026-03-01T08:00:00Z");
}

#[test]
fn a_sensitivity_follows_the_unit_of_each_column() {
    let folder = Folder::with_file("in.csv", b"a [V],b [mV]\n1,100\n-2,50\n");
    folder.convert("in.csv", "out.mcap", "--rate 10 --sensitivity-mv-per-g 100").unwrap();
    folder.convert("in.csv", "out.wav", "--rate 10 --sensitivity-mv-per-g 100").unwrap();
    for record in folder.records("out.mcap").iter().chain(&folder.records("out.wav")) {
        let expected = if ["a", "1"].contains(&record.channel()) { [10.0, -20.0] } else { [1.0, 0.5] };
        assert_eq!(record.samples(), expected, "{}", record.channel());
    }
    assert!(folder.records("out.mcap").iter().all(|record| record.unit() == "g"));
    let scaled = RecordDefaults { scale: Some(2.0), ..RecordDefaults::default() };
    let error = RecordingFile::open(folder.path("out.mcap"), scaled, None).err().unwrap().to_string();
    assert!(error.contains("expected none: the samples of an MCAP recording are in their unit"), "{error}");
}

#[test]
fn records_have_the_requested_length() {
    let text: String = (0..25).map(|k| format!("{k}\n")).collect();
    let folder = Folder::with_file("in.csv", text.as_bytes());
    folder.convert("in.csv", "out.mcap", "--rate 10 --unit g --record-seconds 1").unwrap();
    let records = folder.records("out.mcap");
    assert_eq!(records.iter().map(|r| r.samples().len()).collect::<Vec<_>>(), [10, 10, 5]);
    assert_eq!(records[2].start_time().as_second(), 2);
    assert_eq!(records[2].samples()[0], 20.0);
}

#[test]
fn conversion_by_way_of_wav_gives_the_same_records() {
    let folder = Folder::with_file("in.csv", b"a,b\n1.25,-7\n3.7e5,0.001\n");
    folder.convert("in.csv", "out.wav", "--rate 8000 --unit g").unwrap();
    folder.convert("out.wav", "over.mcap", "--unit g --channels 2,1").unwrap();
    folder.convert("in.csv", "direct.mcap", "--rate 8000 --unit g --channels b,a").unwrap();
    let (over, direct) = (folder.records("over.mcap"), folder.records("direct.mcap"));
    assert_eq!(over.len(), 2);
    for (over, direct) in over.iter().zip(&direct) {
        assert_eq!((over.samples(), over.sample_rate_hz()), (direct.samples(), direct.sample_rate_hz()));
    }
    assert_eq!(over[0].channel(), "2");
}

#[test]
fn invalid_input_is_rejected_and_leaves_no_file() {
    let folder = Folder::with_file("in.csv", b"a\n1\nx\n");
    fs::write(folder.path("there.mcap"), b"mine").unwrap();
    fs::write(folder.path("empty.csv"), b"").unwrap();
    fs::write(folder.path("good.csv"), b"a\n1\n").unwrap();
    fs::write(folder.path("bare.csv"), b"a,b\n").unwrap();
    fs::write(folder.path("magic.csv"), mcap::MAGIC).unwrap();
    fs::write(folder.path("binary.csv"), [0, 1, 2]).unwrap();
    fs::write(folder.path("timed.csv"), "Zeit [s];a\n0,0;1\n0,1;2\n").unwrap();
    let before = folder.names();
    for (input, output, options, expected) in [
        ("in.csv", "out.mcap", "--rate 10 --unit g", "in.csv: csv line 3, column \"a\": \"x\""),
        ("in.csv", "out.wav", "--rate 10 --unit g", "csv line 3"),
        ("good.csv", "out.mcap", "--unit g", "the sampling rate is missing"),
        ("good.csv", "out.mcap", "--rate 10", "--unit is missing"),
        ("good.csv in.csv", "out.mcap", "--rate 10 --unit g", "in.csv: csv line 3"),
        ("good.csv timed.csv", "out.wav", "--rate 10 --unit g", "in .mcap for several recordings"),
        ("none-*.csv", "out.mcap", "--rate 10 --unit g", "no file matches"),
        ("good.csv", "out.mcap", "--rate 10 --unit g --scale 0", "--scale is 0"),
        ("good.csv", "out.mcap", "--rate 10 --unit g --shaft-speed-hz -2", "shaft_speed_hz is -2"),
        ("good.csv", "out.mcap", "--rate 10 --unit g --record-seconds 0", "the cut is 0 samples"),
        ("in.csv", "out.mcap", "--rate 10 --unit g --asset Pump!", "--asset: asset id is \"Pump!\""),
        ("in.csv", "out.mcap", "--rate 10 --unit g --channels b", "no column \"b\""),
        ("in.csv", "out.flac", "--rate 10 --unit g", "OUT is"),
        ("in.csv", "there.mcap", "--rate 10 --unit g", "exists, expected a new file"),
        ("in.csv", "there.mcap", "--rate 10 --unit g --force", "csv line 3"),
        ("no.csv", "out.mcap", "--rate 10 --unit g", "No such file"),
        ("empty.csv", "out.mcap", "--rate 10 --unit g", "0 bytes"),
        ("bare.csv", "out.mcap", "--rate 10 --unit g", "no samples below the header"),
        ("bare.csv", "out.wav", "--rate 10 --unit g", "no samples below the header"),
        ("magic.csv", "out.mcap", "--rate 10 --unit g", "format is MCAP"),
        ("binary.csv", "out.mcap", "--rate 10 --unit g", "the format is unknown"),
        ("timed.csv", "out.mcap", "--rate 11 --unit g", "the sampling rate is 11 Hz, expected 10 Hz"),
        ("bare.csv", "sub/out.wav", "--rate 10 --unit g", "out.wav"),
    ] {
        let error = folder.convert(input, output, options).unwrap_err();
        assert!(error.contains(expected), "{input} {output} {options}: {error}");
        assert_eq!(folder.names(), before, "{input} {output} {options}");
    }
    assert_eq!(fs::read(folder.path("there.mcap")).unwrap(), b"mine");
}

#[test]
fn recordings_of_many_formats_follow_one_another() {
    let folder = Folder::with_file("a.csv", b"x\n1\n2\n");
    folder.convert("a.csv", "b.wav", "--rate 2").unwrap();
    let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
    packed.write_all(b"x,y\n5,6\n7,8\n").unwrap();
    fs::write(folder.path("c.csv.gz"), packed.finish().unwrap()).unwrap();
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures");
    fs::copy(fixtures.join("flac/one-sample.flac"), folder.path("d.flac")).unwrap();
    folder.convert("a.csv b.wav c.csv.gz d.flac", "out.mcap", "--rate 2 --unit g --scale 10").unwrap();
    let records = folder.records("out.mcap");
    let found: Vec<_> =
        records.iter().map(|r| (r.channel(), r.start_time().as_second(), r.samples()[0])).collect();
    let flac = records[4].samples()[0];
    assert_eq!(found, [("x", 0, 10.0), ("1", 1, 10.0), ("x", 2, 50.0), ("y", 2, 60.0), ("1", 3, flac)]);
    folder.convert("*.flac", "whole.wav", "--scale 10").unwrap();
    assert_eq!(folder.records("whole.wav")[0].samples(), [flac]);
}

#[test]
fn times_of_day_count_from_the_given_day_on() {
    let clock = |hour: u32, minute: u32| -> String {
        (0..4).map(|k| format!("{hour},{minute},10,{},{},0.5\n", 250_000 * k, k % 2)).collect()
    };
    let folder = Folder::with_file("acc_1.csv", clock(23, 59).as_bytes());
    fs::write(folder.path("acc_2.csv"), clock(0, 9)).unwrap();
    fs::write(folder.path("acc_3.csv"), clock(0, 19)).unwrap();
    folder.convert("acc_*.csv", "out.mcap", "--unit g --start-time 2010-11-17T00:00:00Z").unwrap();
    let times: Vec<String> =
        folder.records("out.mcap").iter().step_by(2).map(|record| record.start_time().to_string()).collect();
    assert_eq!(times, ["2010-11-17T23:59:10Z", "2010-11-18T00:09:10Z", "2010-11-18T00:19:10Z"]);
}

#[test]
fn force_replaces_the_output() {
    let folder = Folder::with_file("in.csv", b"1\n2\n");
    fs::write(folder.path("out.wav"), b"old").unwrap();
    folder.convert("in.csv", "out.wav", "--rate 10 --unit g --force").unwrap();
    assert_eq!(folder.records("out.wav")[0].samples(), [1.0, 2.0]);
}

/// The six files of `gearbox-spectraquest`.
#[test]
#[ignore = "needs the folder of real recordings"]
fn real_gearbox_recordings_agree_in_wav_and_mcap() {
    let recordings = flankwatch_test_support::recordings("gearbox-spectraquest");
    for name in ["h30hz0", "h30hz50", "h30hz90", "b30hz0", "b30hz50", "b30hz90"] {
        let mut text = Vec::new();
        let packed = fs::File::open(recordings.join(format!("{name}.csv.gz"))).unwrap();
        GzDecoder::new(packed).read_to_end(&mut text).unwrap();
        let folder = Folder::with_file("in.csv", &text);
        let rows = text.iter().filter(|&&byte| byte == b'\n').count() - 1;
        folder.convert("in.csv", "out.wav", "--rate 12800 --unit g").unwrap();
        folder.convert("in.csv", "out.mcap", "--rate 12800 --unit g").unwrap();
        let (wav, mcap) = (folder.records("out.wav"), folder.records("out.mcap"));
        assert_eq!((wav.len(), mcap.len()), (4, 4));
        for (k, (wav, mcap)) in wav.iter().zip(&mcap).enumerate() {
            assert_eq!(wav.samples(), mcap.samples());
            assert_eq!((mcap.samples().len(), mcap.channel()), (rows, format!("a{}", k + 1).as_str()));
            for (sample, line) in mcap.samples().iter().zip(text.split(|&byte| byte == b'\n').skip(1)) {
                let field = std::str::from_utf8(line).unwrap().split(',').nth(k).unwrap();
                let value: f64 = field.trim().parse().unwrap();
                assert!((f64::from(*sample) - value).abs() <= 1e-6 * value.abs());
            }
        }
    }
}
