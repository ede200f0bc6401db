//! What the documents point at is there.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Folders whose documents are read.
const FOLDERS: [&str; 3] = [".", "docs", "benches"];

#[test]
fn every_link_of_a_document_leads_somewhere() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let documents: Vec<PathBuf> = FOLDERS
        .iter()
        .flat_map(|folder| fs::read_dir(root.join(folder)).unwrap())
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "md"))
        .collect();
    assert!(documents.len() > 10, "{documents:?}");
    let broken: Vec<String> = documents.iter().flat_map(|document| broken_links(document)).collect();
    assert!(broken.is_empty(), "{broken:#?}");
}

#[test]
fn a_heading_is_linked_as_github_does() {
    assert_eq!(anchor("What is `not` wear, ± 5 %"), "what-is-not-wear--5-");
    let text = "see [a](b.md#c) and [d](#e-f)";
    assert_eq!(links(text), ["b.md#c", "#e-f"]);
}

/// Links within the project whose file or heading is not there.
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

/// The targets of `[text](target)`.
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

/// What GitHub makes of a heading: lower case, without punctuation, spaces as hyphens.
fn anchor(heading: &str) -> String {
    heading
        .to_lowercase()
        .chars()
        .filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'))
        .map(|c| if c == ' ' { '-' } else { c })
        .collect()
}
