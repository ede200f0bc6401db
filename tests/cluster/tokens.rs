//! Tokens apply to all nodes, wherever they are created and revoked.

use std::path::Path;
use std::time::{Duration, Instant};

use super::client::Client;
use super::site::Site;
use crate::command::flankwatch;

/// Timeout for a change to reach every node.
const KNOWN_WITHIN: Duration = Duration::from_secs(5);

fn status(client: &Client, token: Option<&str>) -> u16 {
    let authorization = token.map(|token| format!("Bearer {token}"));
    let headers: Vec<(&str, &str)> =
        authorization.iter().map(|value| ("authorization", value.as_str())).collect();
    client.try_send_with("GET", "/v1/assets", &headers, b"").unwrap().0
}

#[track_caller]
fn wait_for_status(client: &Client, token: Option<&str>, wanted: u16) {
    let began = Instant::now();
    loop {
        let found = status(client, token);
        if found == wanted {
            return;
        }
        assert!(began.elapsed() < KNOWN_WITHIN, "still {found}, expected {wanted}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

fn token(words: &[&str], config: &Path) -> String {
    let config = config.display().to_string();
    let output =
        flankwatch(&[&["token"][..], words, &["--config", config.as_str()]].concat()).expect_success();
    output.out().trim().to_owned()
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn a_token_created_or_revoked_on_one_node_applies_on_all() {
    let mut site = Site::start();
    let config = site.config(None);
    let nodes = [site.api(&config), site.api(&config)];
    assert_eq!(status(&nodes[0].client, None), 200, "without any token a node on its own machine is open");
    let first = token(&["create", "press line", "--scope", "write"], &config);
    let second = token(&["create", "display"], &config);
    for node in &nodes {
        wait_for_status(&node.client, None, 401);
        wait_for_status(&node.client, Some(&first), 200);
        wait_for_status(&node.client, Some(&second), 200);
    }
    let listed = token(&["list"], &config);
    assert!(listed.contains("press line") && listed.lines().count() == 3, "{listed}");
    assert!(!listed.contains(first.rsplit('_').next().unwrap()), "{listed}");
    let id = first.split('_').nth(1).unwrap();
    token(&["revoke", id], &config);
    for node in &nodes {
        wait_for_status(&node.client, Some(&first), 401);
        assert_eq!(status(&node.client, Some(&second)), 200);
    }
    let config_text = config.display().to_string();
    flankwatch(&["token", "revoke", id, "--config", &config_text]).expect_failure(&[id]);
    // Revoking every token does not reopen the service, not even after a restart.
    token(&["revoke", second.split('_').nth(1).unwrap()], &config);
    wait_for_status(&nodes[0].client, Some(&second), 401);
    let [_, again] = nodes;
    drop(again);
    let again = site.api(&config);
    assert_eq!(status(&again.client, None), 401);
}
