//! Runs of a second simulator, which shares no code with this project: the wear estimate beside the truth,
//! with a pair file that says nothing of damping, bodies or the shape of the wear.

use flankwatch_test_support::recordings;
use serde_json::Value;

use crate::command::flankwatch;

/// Run, least part of the estimates that hold the truth, most estimates in a row that do not, least rank
/// correlation.
const WEAR: [(&str, f64, u64, f64); 4] = [
    ("wear-threshold-1", 0.85, 10, 0.97),
    ("wear-threshold-2", 0.85, 10, 0.97),
    ("wear-loaded-1", 0.85, 10, 0.97),
    ("wear-loaded-2", 0.85, 10, 0.97),
];

/// Runs with a fault from record 75 on, and the healthy one.
const FAULTS: [&str; 2] = ["crack-12", "gain-jump-13"];
const HEALTHY: &str = "healthy-11";

fn scores() -> Value {
    let folder = recordings("second-simulator");
    let data = tempfile::tempdir().unwrap();
    let runs: Vec<String> = WEAR
        .iter()
        .map(|(run, ..)| *run)
        .chain(FAULTS)
        .chain([HEALTHY])
        .map(|run| folder.join(run).display().to_string())
        .collect();
    let mut words = vec!["evaluate", "--json", "--data-dir"];
    let data = data.path().display().to_string();
    words.extend([data.as_str(), "--recorded"]);
    words.extend(runs.iter().map(String::as_str));
    let said = flankwatch(&words).expect_success();
    serde_json::from_str(&said.out()).unwrap()
}

#[test]
#[ignore = "needs the folder of real recordings"]
fn the_interval_holds_the_truth_of_another_simulators_runs() {
    let all = scores();
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
        assert!(score["flagged"].as_f64().unwrap() <= 0.03 * records, "{score}");
    }
    let healthy = score(HEALTHY);
    assert_eq!(healthy["flagged"], 0, "{healthy}");
    let [median, _, high] = [0, 1, 2].map(|i| healthy["last"][i].as_f64().unwrap());
    assert!(median <= 5.0 && high <= 30.0, "{healthy}");
    for run in FAULTS {
        let flagged = |answer: &Value| answer["flagged"].as_bool().unwrap();
        let answers = all["answers"][run].as_array().unwrap().clone();
        let (before, after): (Vec<Value>, Vec<Value>) =
            answers.into_iter().partition(|answer| answer["record"].as_u64().unwrap() < 75);
        assert_eq!(before.iter().filter(|answer| flagged(answer)).count(), 0, "{run}");
        let late = after.iter().skip(10);
        let found = late.clone().filter(|answer| flagged(answer)).count() as f64;
        assert!(found >= 0.95 * late.count() as f64, "{run}: {found}");
    }
}
