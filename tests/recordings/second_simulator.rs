//! Runs of a second simulator, which shares no code with this project: the wear estimate compared with the
//! truth, with a pair file that has no damping, gear bodies or wear shape.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use flankwatch::recording::{RecordDefaults, RecordingFile, WavWriter};
use flankwatch::signal::{AnalysisSettings, Analyzer, MeshContext, Record};
use flankwatch_test_support::recordings;
use jiff::Timestamp;
use serde_json::Value;

use crate::command::flankwatch;

/// Run, minimum coverage, maximum number of consecutive misses, minimum rank correlation.
const WEAR: [(&str, f64, u64, f64); 4] = [
    ("wear-threshold-1", 0.85, 10, 0.97),
    ("wear-threshold-2", 0.85, 10, 0.97),
    ("wear-loaded-1", 0.85, 10, 0.97),
    ("wear-loaded-2", 0.85, 10, 0.97),
];

/// Runs with a fault from record 75 on, and the healthy one.
/// Runs with a fault from record 75 on, and its name.
const FAULTS: [(&str, &str); 2] = [("crack-12", "one_tooth"), ("gain-jump-13", "gain_changed")];
const HEALTHY: &str = "healthy-11";

/// Returns the folder of a run.
fn packed(run: &str) -> PathBuf {
    recordings("second-simulator").join(run)
}

/// Only one command at a time simulates the ensemble; the others find it in the cache.
static SIMULATED: Mutex<()> = Mutex::new(());

/// Runs `evaluate` on recorded runs and returns its JSON.
fn scores(runs: &[PathBuf], further: &[&str]) -> Value {
    let _alone = SIMULATED.lock().unwrap_or_else(PoisonError::into_inner);
    let data = Path::new(env!("CARGO_TARGET_TMPDIR")).join("second-simulator").display().to_string();
    let runs: Vec<String> = runs.iter().map(|run| run.display().to_string()).collect();
    let mut words = [&["evaluate", "--json", "--data-dir", &data], further, &["--recorded"]].concat();
    words.extend(runs.iter().map(String::as_str));
    let output = flankwatch(&words).expect_success();
    serde_json::from_str(&output.out()).unwrap()
}

#[test]
#[ignore = "needs the folder of real recordings"]
fn the_interval_covers_the_truth_on_another_simulators_runs() {
    let worn = WEAR.map(|(run, ..)| packed(run));
    let others = FAULTS.map(|(run, _)| run).into_iter().chain([HEALTHY]).map(packed);
    let all = scores(&worn.iter().cloned().chain(others).collect::<Vec<_>>(), &[]);
    let score = |run: &str| {
        all["scores"].as_array().unwrap().iter().find(|score| score["run"] == run).unwrap().clone()
    };
    for (run, coverage, longest, rank) in WEAR {
        let score = score(run);
        println!("{score}");
        assert!(score["coverage"].as_f64().unwrap() >= coverage, "{score}");
        assert!(score["longest_miss"].as_u64().unwrap() <= longest, "{score}");
        assert!(score["rank"].as_f64().unwrap() >= rank, "{score}");
        let records = score["records"].as_f64().unwrap();
        let named = all["answers"][run].as_array().unwrap().iter();
        let one_tooth = named.filter(|answer| answer["suspected_fault"] == "one_tooth").count() as f64;
        assert!(one_tooth <= 0.01 * records, "{run}: {one_tooth} records of wear named a fault of one tooth");
        assert!(score["flagged"].as_f64().unwrap() <= 0.03 * records, "{score}");
    }
    let healthy = score(HEALTHY);
    assert_eq!(healthy["flagged"], 0, "{healthy}");
    let [median, _, high] = [0, 1, 2].map(|i| healthy["last"][i].as_f64().unwrap());
    assert!(median <= 5.0 && high <= 30.0, "{healthy}");
    for (run, name) in FAULTS {
        let flagged = |answer: &Value| answer["flagged"].as_bool().unwrap();
        let answers = all["answers"][run].as_array().unwrap().clone();
        let (before, after): (Vec<Value>, Vec<Value>) =
            answers.into_iter().partition(|answer| answer["record"].as_u64().unwrap() < 75);
        assert_eq!(before.iter().filter(|answer| flagged(answer)).count(), 0, "{run}");
        let late = after.iter().skip(10);
        let found: Vec<&Value> = late.clone().filter(|answer| flagged(answer)).collect();
        assert!(found.len() as f64 >= 0.95 * late.count() as f64, "{run}: {}", found.len());
        let is_named =
            |answer: &&&Value| [&answer["suspected_fault"], &answer["sensor_fault"]].contains(&&name.into());
        let named = found.iter().filter(is_named).count();
        assert!(named as f64 >= 0.95 * found.len() as f64, "{run}: {named} of {} named {name}", found.len());
    }
    // An inspection half-way narrows the intervals of earlier records, which still cover the truth.
    let inspected = scores(&worn, &["--inspection-um", "5"]);
    let (mut told_um, mut looked_back_um) = (0.0, 0.0);
    for score in inspected["scores"].as_array().unwrap() {
        let [width, coverage, error] = ["width_um", "coverage", "error_um"]
            .map(|name| [0, 1].map(|which| score["in_hindsight"][name][which].as_f64().unwrap()));
        println!(
            "{} looked back at: {width:?} µm wide, {coverage:?} covered, {error:?} µm off",
            score["run"]
        );
        assert!(width[1] < width[0] && coverage[1] >= 0.85 && error[1] <= 10.0, "{score}");
        told_um += width[0];
        looked_back_um += width[1];
    }
    assert!(looked_back_um <= 0.7 * told_um, "{looked_back_um} of {told_um} µm");
}

/// Returns record `n` of a run, resampled as if the machine had run faster by a factor.
fn turned_faster(run: &str, n: usize, factor: f64) -> Record {
    let path = packed(run).join(format!("rec_{n:04}.wav"));
    let mut records = RecordingFile::open(path, RecordDefaults::default(), None).unwrap();
    let record = records.next().unwrap().unwrap().record;
    let rate_hz = factor * record.sample_rate_hz();
    Record::new("1", Timestamp::UNIX_EPOCH, rate_hz, "m/s2", record.samples().to_vec()).unwrap()
}

/// Returns the signal of a sensor at another place on the machine, with its own noise.
fn heard_elsewhere(samples: &[f32]) -> Vec<f32> {
    let rms = (samples.iter().map(|x| x * x).sum::<f32>() / samples.len() as f32).sqrt();
    let noise = |i: usize| (((i * 7919 + i * i % 8191) % 1009) as f32 / 504.5 - 1.0) * 0.1 * rms;
    let before = |i: usize, back: usize| i.checked_sub(back).map_or(0.0, |at| samples[at]);
    let filtered = |i: usize| samples[i] - 0.7 * before(i, 1) + 0.4 * before(i, 5) + noise(i);
    (0..samples.len()).map(filtered).collect()
}

/// Errors of a library affect every channel, so the joint interval is as wide as those of the channels.
#[test]
#[ignore = "needs the folder of real recordings"]
fn channels_are_scored_individually_and_together() {
    let data = tempfile::tempdir().unwrap();
    let run = data.path().join("two");
    fs::create_dir(&run).unwrap();
    fs::copy(packed("wear-loaded-1").join("truth.csv"), run.join("truth.csv")).unwrap();
    for n in 0..speeds_hz("wear-loaded-1").len() {
        let record = turned_faster("wear-loaded-1", n, 1.0);
        let file = File::create(run.join(format!("{n:04}.wav"))).unwrap();
        let mut wav = WavWriter::new(file, 2, record.sample_rate_hz()).unwrap();
        let elsewhere = heard_elsewhere(record.samples());
        for (here, there) in record.samples().iter().zip(elsewhere) {
            wav.write_frame(&[*here, there]).unwrap();
        }
        wav.finish().unwrap();
    }
    let all = scores(&[run], &[]);
    let scores = all["scores"].as_array().unwrap();
    let names: Vec<&str> = scores.iter().map(|score| score["run"].as_str().unwrap()).collect();
    assert_eq!(names, ["two, channel 1", "two, channel 2", "two, together"]);
    let of = |name: &str| [0, 1, 2].map(|i| scores[i][name].as_f64().unwrap());
    let [coverage, width] = [of("coverage"), of("width_um")];
    println!("covered {coverage:?}, {width:?} µm wide");
    assert!(coverage.iter().all(|part| *part >= 0.85), "{coverage:?}");
    let (least, most) = (width[0].min(width[1]), width[0].max(width[1]));
    assert!(0.9 * least <= width[2] && width[2] <= 1.2 * most, "{width:?}");
}

/// Returns the true shaft speeds of a run in hertz.
fn speeds_hz(run: &str) -> Vec<f64> {
    let text = fs::read_to_string(packed(run).join("truth.csv")).unwrap();
    text.lines().skip(1).map(|line| line.split(',').nth(2).unwrap().parse().unwrap()).collect()
}

/// Speeds that vary by ± 20 % between records are found within 25 % of nominal, or marked as doubtful; with
/// wrong tooth counts or a wrong nominal speed they are doubtful. The speed fluctuates by ± 0.3 % within a
/// record.
#[test]
#[ignore = "needs the folder of real recordings"]
fn a_detected_speed_is_correct_or_marked_as_doubtful() {
    let mut analyzer = Analyzer::new(AnalysisSettings::default());
    let mut count = |teeth: u32, nominal_shaft_speed_hz: f64, tolerance: f64, spread: f64| {
        let mesh = MeshContext::new([teeth, 26], nominal_shaft_speed_hz, tolerance);
        let (mut right, mut doubted, mut wrong) = (0, 0, 0);
        for run in WEAR.map(|(run, ..)| run).into_iter().chain(FAULTS.map(|(run, _)| run)).chain([HEALTHY]) {
            for (n, speed_hz) in speeds_hz(run).into_iter().enumerate().step_by(5) {
                // Evenly distributed, in random order.
                let factor = 1.0 + spread * (2.0 * (n as f64 * 0.618).fract() - 1.0);
                let found = analyzer.analyze(&turned_faster(run, n, factor), &mesh).shaft_speed;
                let is_right = |found: f64| (found / (factor * speed_hz) - 1.0).abs() < 0.003;
                match found.filter(|found| found.doubt.is_none()) {
                    None => doubted += 1,
                    Some(found) if teeth == 24 && is_right(found.shaft_speed_hz) => right += 1,
                    Some(_) => wrong += 1,
                }
            }
        }
        println!(
            "{teeth} teeth at {nominal_shaft_speed_hz} Hz ± {tolerance}, {spread}: {right} {doubted} {wrong}"
        );
        (right, doubted, wrong)
    };
    for (tolerance, spread) in [(0.05, 0.0), (0.25, 0.0), (0.25, 0.2)] {
        let (right, doubted, wrong) = count(24, 16.64, tolerance, spread);
        assert!(
            wrong * 100 <= right && doubted * 10 <= right,
            "{tolerance} {spread}: {right} {doubted} {wrong}"
        );
    }
    for (teeth, nominal_hz) in [(32, 30.0), (20, 16.64), (48, 16.64), (24, 25.0), (24, 12.0)] {
        let (_, doubted, wrong) = count(teeth, nominal_hz, 0.05, 0.0);
        assert!(wrong * 100 <= doubted, "{teeth} teeth at {nominal_hz} Hz: {doubted} {wrong}");
    }
}
