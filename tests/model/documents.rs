//! Links and commands in the documentation exist.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Folders whose documents are checked.
const FOLDERS: [&str; 3] = [".", "docs", "benches"];

#[test]
fn every_link_in_the_documentation_resolves() {
    let documents = documents();
    assert!(documents.len() > 10, "{documents:?}");
    let broken: Vec<String> = documents.iter().flat_map(|document| broken_links(document)).collect();
    assert!(broken.is_empty(), "{broken:#?}");
}

/// Each line of a shell block that runs the program has an existing command and existing options.
#[test]
fn commands_in_the_documentation_exist() {
    let mut checked = 0;
    for document in documents() {
        let text = fs::read_to_string(&document).unwrap();
        for line in commands(&text) {
            let words: Vec<&str> = line.split_whitespace().collect();
            let names: Vec<&str> = words
                .iter()
                .copied()
                .take_while(|word| word.chars().all(|c| c.is_ascii_lowercase() || c == '-'))
                .take(2)
                .collect();
            let Some((help, _)) = names.iter().enumerate().rev().find_map(|(n, _)| {
                let output = Command::new(env!("CARGO_BIN_EXE_flankwatch"))
                    .args(&names[..=n])
                    .arg("--help")
                    .output()
                    .unwrap();
                output.status.success().then(|| (String::from_utf8(output.stdout).unwrap(), n))
            }) else {
                panic!("{}: no such command: flankwatch {line}", document.display());
            };
            for option in words.iter().filter(|word| word.starts_with("--") && word.len() > 2) {
                let option = option.split('=').next().unwrap();
                assert!(help.contains(option), "{}: {option} of flankwatch {line}", document.display());
            }
            checked += 1;
        }
    }
    assert!(checked >= 30, "{checked} commands");
}

#[test]
fn heading_anchors_match_those_of_github() {
    assert_eq!(anchor("What is `not` wear, ± 5 %"), "what-is-not-wear--5-");
    let text = "see [a](b.md#c) and [d](#e-f)";
    assert_eq!(links(text), ["b.md#c", "#e-f"]);
}

fn documents() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let entries = FOLDERS.iter().flat_map(|folder| fs::read_dir(root.join(folder)).unwrap());
    let paths = entries.map(|entry| entry.unwrap().path());
    paths.filter(|path| path.extension().is_some_and(|extension| extension == "md")).collect()
}

/// Returns the arguments of `flankwatch` in shell blocks; a trailing backslash continues the line.
fn commands(text: &str) -> Vec<String> {
    let text = text.replace("\\\n", " ");
    let mut is_shell = false;
    let mut found = Vec::new();
    for line in text.lines() {
        if let Some(fence) = line.trim_start().strip_prefix("```") {
            is_shell = !is_shell && (fence.starts_with("sh") || fence == "bash");
            continue;
        }
        let line = line.split(" #").next().unwrap_or_default();
        let calls = line.split('|').filter(|_| is_shell);
        found.extend(calls.filter_map(|call| {
            let call = call.trim().trim_start_matches("cargo run --release -- ");
            let rest = call.strip_prefix("flankwatch ").or_else(|| {
                line.trim().strip_prefix("cargo run --release -- ").filter(|_| line.contains("cargo run"))
            })?;
            Some(rest.to_owned())
        }));
    }
    found
}

/// Returns links within the project whose file or heading does not exist.
fn broken_links(document: &Path) -> Vec<String> {
    let text = fs::read_to_string(document).unwrap();
    links(&text)
        .into_iter()
        .filter(|link| !link.starts_with("http") && !link.starts_with("mailto:"))
        .filter(|link| {
            let (file, heading) = link.split_once('#').unwrap_or((link, ""));
            let target =
                if file.is_empty() { document.to_owned() } else { document.parent().unwrap().join(file) };
            !target.exists()
                || (!heading.is_empty()
                    && target.extension().is_some_and(|extension| extension == "md")
                    && !headings(&target).contains(heading))
        })
        .map(|link| format!("{}: {link}", document.display()))
        .collect()
}

/// Returns the targets of `[text](target)`.
fn links(text: &str) -> Vec<&str> {
    text.split("](").skip(1).filter_map(|rest| rest.split_once(')').map(|(link, _)| link)).collect()
}

fn headings(document: &Path) -> HashSet<String> {
    let text = fs::read_to_string(document).unwrap();
    text.lines()
        .filter(|line| line.starts_with('#'))
        .map(|line| anchor(line.trim_start_matches('#').trim()))
        .collect()
}

/// Returns GitHub's anchor of a heading: lower case, without punctuation, spaces as hyphens.
fn anchor(heading: &str) -> String {
    heading
        .to_lowercase()
        .chars()
        .filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'))
        .map(|c| if c == ' ' { '-' } else { c })
        .collect()
}
