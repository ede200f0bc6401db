//! The rooms' dependencies point one way, and the pure rooms stay pure.

use std::fs;
use std::path::{Path, PathBuf};

/// Each room and the rooms it may name.
const ROOMS: [(&str, &[&str]); 15] = [
    ("gear", &[]),
    ("signal", &[]),
    ("library", &["gear", "signal"]),
    ("simulation", &["gear", "signal"]),
    ("figures", &["gear", "signal"]),
    ("estimate", &["library", "signal"]),
    ("evaluation", &["gear", "signal", "library", "simulation", "estimate"]),
    ("recording", &["signal"]),
    ("asset", &["gear", "signal", "estimate"]),
    ("report", &["signal", "estimate", "asset"]),
    ("store", &["gear", "signal", "library", "estimate", "asset"]),
    ("service", &["gear", "signal", "library", "estimate", "recording", "asset", "store"]),
    (
        "http",
        &[
            "gear",
            "signal",
            "library",
            "estimate",
            "recording",
            "asset",
            "report",
            "store",
            "service",
        ],
    ),
    ("cluster", &["signal", "recording", "asset", "store", "service"]),
    (
        "cli",
        &[
            "gear",
            "signal",
            "library",
            "simulation",
            "figures",
            "estimate",
            "evaluation",
            "recording",
            "asset",
            "report",
            "store",
            "service",
            "http",
            "cluster",
        ],
    ),
];

/// Rooms without a runtime, a database, a clock, the environment or chance.
const PURE: [&str; 9] = [
    "gear",
    "signal",
    "library",
    "simulation",
    "figures",
    "estimate",
    "evaluation",
    "recording",
    "report",
];

const IMPURE: [&str; 10] = [
    "tokio",
    "axum",
    "sqlx",
    "std::env",
    "SystemTime",
    "Instant::",
    "Timestamp::now",
    "rand::rng(",
    "thread_rng",
    "from_os_rng",
];

#[test]
fn a_room_names_only_rooms_above_it() {
    let mut wrong = Vec::new();
    for (room, allowed) in ROOMS {
        for (path, text) in sources(room) {
            for named in rooms_named(&text) {
                if named != room && !allowed.contains(&named.as_str()) {
                    wrong.push(format!("{} names {named}", path.display()));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_folder_of_the_source_is_a_room_of_the_table() {
    let known: Vec<&str> = ROOMS.iter().map(|(room, _)| *room).collect();
    for entry in fs::read_dir(source()).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            let name = path.file_name().unwrap().to_str().unwrap();
            assert!(known.contains(&name), "src/{name} is not in the table");
        }
    }
}

#[test]
fn pure_rooms_have_no_runtime_clock_or_chance() {
    let mut wrong = Vec::new();
    for room in PURE {
        for (path, text) in sources(room) {
            wrong.extend(
                IMPURE
                    .iter()
                    .filter(|word| text.contains(*word))
                    .map(|word| format!("{} uses {word}", path.display())),
            );
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

fn source() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

/// Every Rust file of a room, without its unit tests.
fn sources(room: &str) -> Vec<(PathBuf, String)> {
    let mut folders = vec![source().join(room)];
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.file_stem().is_some_and(|stem| stem == "tests") {
                continue;
            }
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = fs::read_to_string(&path).unwrap();
                let code = text.split("#[cfg(test)]\nmod tests").next().unwrap_or_default().to_owned();
                files.push((path, code));
            }
        }
    }
    assert!(!files.is_empty(), "src/{room} has no files");
    files
}

/// The rooms after `crate::` in a text, braces taken apart.
fn rooms_named(text: &str) -> Vec<String> {
    text.split("crate::")
        .skip(1)
        .map(|rest| rest.chars().take_while(|c| c.is_ascii_lowercase() || *c == '_').collect::<String>())
        .filter(|name| ROOMS.iter().any(|(room, _)| room == name))
        .collect()
}
