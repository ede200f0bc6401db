//! What a lost word leaves undone is found.

use serde_json::json;

use super::nodes::TestCluster;
use crate::running::{minute, plain_asset, record};

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and NATS at FLANKWATCH_TEST_NATS"]
fn a_listener_that_no_worker_was_told_of_has_the_earlier_records() {
    let cluster = TestCluster::start(1, 2);
    let node = cluster.client(0);
    node.send_json("POST", "/v1/assets", &plain_asset("first"), 201);
    for n in 0..8 {
        node.upload("first", &record("in", n));
    }
    node.wait_for("/v1/assets/first", |asset| asset["summary"]["segments"] == 8);
    let mut second = plain_asset("second");
    second["gear"] = json!({ "teeth": [17, 50], "shaft_speed_hz": 5.0, "shaft_ratio": [31, 62] });
    second["sensor"]["of"] = json!("first");
    let second = serde_json::from_value(second).unwrap();
    cluster.behind_their_backs(async |store| store.insert_asset(&second, None, minute(0)).await.unwrap());
    node.wait_for("/v1/assets/second", |asset| asset["summary"]["segments"] == 8);
    let late = cluster.behind_their_backs(async |store| {
        for _ in 0..200 {
            let late = store.late_members(10).await.unwrap();
            if late.is_empty() {
                return late;
            }
            tokio::time::sleep(std::time::Duration::from_millis(50)).await;
        }
        store.late_members(10).await.unwrap()
    });
    assert!(late.is_empty(), "{late:?} is looked at again and again");
}
