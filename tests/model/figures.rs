//! The page of the figures of the model's paper.

use std::fs;

use serde::Deserialize;
use serde_json::{Value, json};

use crate::command::flankwatch;

#[test]
fn the_page_is_self_contained_and_its_numbers_match_the_reference() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let (page, data) = (at("figures.html"), at("figures.json"));
    let output = flankwatch(&["figures", "--out", &page, "--data", &data]).expect_success();
    let page = fs::read_to_string(page).unwrap();
    for number in [7, 8, 11, 12, 13, 14, 15, 17, 18, 19, 20, 21, 22] {
        assert!(page.contains(&format!("<figure id=\"fig{number}\">")), "Fig. {number}");
    }
    // Plotly's code has host names that it contacts for maps only; the page itself loads nothing.
    let asks = page.contains("<script src") || page.contains("<link") || page.contains("<img src=\"http");
    assert!(!asks, "the page asks for something from elsewhere");
    let data: Value = serde_json::from_slice(&fs::read(data).unwrap()).unwrap();
    assert_eq!(data["vibration"]["indicators"].as_array().unwrap().len(), 50);
    let checks = data["checks"].as_array().unwrap();
    let holding = checks.iter().filter(|check| check["holds"] == true).count();
    assert!(output.out().contains(&format!("{holding} of {} statements hold", checks.len())));
    assert_as_kept(&data);

    let refused = at("refused.html");
    flankwatch(&["figures", "--out", &refused, "--wear-um", "50", "40", "30"])
        .expect_failure(&["--wear-um is", "rising"]);
    assert!(!fs::exists(refused).unwrap());
}

/// The reference values in `fixtures/reference/figures.toml`.
#[derive(Deserialize)]
struct Kept {
    spearman: [f64; 3],
    statement: Vec<Statement>,
    state: Vec<State>,
}

#[derive(Deserialize)]
struct Statement {
    figure: u64,
    statement: String,
    holds: bool,
}

#[derive(Deserialize)]
struct State {
    num: u64,
    rms: f64,
    kurtosis: f64,
    omx: f64,
}

fn assert_as_kept(data: &Value) {
    let kept: Kept = toml::from_str(include_str!("../../fixtures/reference/figures.toml")).unwrap();
    let checks = data["checks"].as_array().unwrap();
    assert_eq!(checks.len(), kept.statement.len());
    for (check, Statement { figure, statement, holds }) in checks.iter().zip(kept.statement) {
        assert_eq!((&check["figure"], &check["statement"]), (&json!(figure), &json!(statement)));
        assert_eq!(check["holds"], holds, "Fig. {figure}: {statement} {}", check["measured"]);
    }
    let vibration = &data["vibration"];
    let states = vibration["indicators"].as_array().unwrap();
    for State { num, rms, kurtosis, omx } in kept.state {
        let state = states.iter().find(|state| state["num"] == num).unwrap();
        for (name, expected) in [("rms", rms), ("kurtosis", kurtosis), ("omx", omx)] {
            let got = state[name].as_f64().unwrap();
            assert!((got / expected - 1.0).abs() < 0.01, "NUM = {num}, {name}: {got} against {expected}");
        }
    }
    for (index, expected) in kept.spearman.iter().enumerate() {
        let got = vibration["spearman"][index].as_f64().unwrap();
        assert!((got - expected).abs() < 0.005, "{index}: {got} against {expected}");
    }
}
