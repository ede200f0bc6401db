//! The page of the model's figures.

use std::fs;

use serde_json::Value;

use crate::command::flankwatch;

#[test]
fn the_page_stands_alone_and_its_numbers_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let (page, data) = (at("figures.html"), at("figures.json"));
    let said = flankwatch(&["figures", "--out", &page, "--data", &data, "--seconds", "0.5"]).expect_success();
    let page = fs::read_to_string(page).unwrap();
    for number in [7, 8, 11, 12, 13, 14, 15, 17, 18, 19, 20, 21, 22] {
        assert!(page.contains(&format!("<figure id=\"fig{number}\">")), "Fig. {number}");
    }
    // Plotly's own code names hosts that it asks only for maps; the page itself asks for nothing.
    let asks = page.contains("<script src") || page.contains("<link") || page.contains("<img src=\"http");
    assert!(!asks, "the page asks for something from elsewhere");
    let data: Value = serde_json::from_slice(&fs::read(data).unwrap()).unwrap();
    assert_eq!(data["vibration"]["indicators"].as_array().unwrap().len(), 50);
    let checks = data["checks"].as_array().unwrap();
    let holding = checks.iter().filter(|check| check["holds"] == true).count();
    assert!(said.out().contains(&format!("{holding} of {} statements hold", checks.len())));

    let refused = at("refused.html");
    flankwatch(&["figures", "--out", &refused, "--wear-um", "50", "40", "30"]).expect_refusal(&["wear_um", "rising"]);
    assert!(!fs::exists(refused).unwrap());
}
