//! Rules that the compiler does not enforce: modules use only modules below them, and the pure packages use
//! no clock, environment, randomness or files.

use std::fs;
use std::path::{Path, PathBuf};

/// A folder's modules, and for each the sibling modules that it may use. The compiler checks dependencies
/// between packages.
type Modules = (&'static str, &'static [(&'static str, &'static [&'static str])]);

const MODULES: [Modules; 3] = [
    (
        "src",
        &[
            ("settings", &[]),
            ("asset", &[]),
            ("report", &["asset"]),
            ("store", &["asset"]),
            ("service", &["asset", "store"]),
            ("http", &["settings", "asset", "report", "store", "service"]),
            ("cluster", &["settings", "asset", "store", "service"]),
            ("mqtt", &["settings", "asset", "store", "service"]),
            ("notifications", &["settings", "asset", "report", "store", "service"]),
            (
                "cli",
                &[
                    "settings",
                    "asset",
                    "report",
                    "store",
                    "service",
                    "http",
                    "cluster",
                    "mqtt",
                    "notifications",
                ],
            ),
        ],
    ),
    ("crates/wear/src", &[("library", &[]), ("simulation", &[]), ("estimate", &["library"])]),
    ("crates/lab/src", &[("figures", &[]), ("evaluation", &[])]),
];

/// Folders without clock, environment, randomness, files or threads.
const PURE: [&str; 7] = [
    "crates/fourier/src",
    "crates/gear/src",
    "crates/signal/src",
    "crates/recording/src",
    "crates/wear/src",
    "crates/lab/src",
    "src/report",
];

/// Files that exist only with the feature `files`.
const FILES: [&str; 3] = [
    "crates/recording/src/file.rs",
    "crates/wear/src/library/checkpoint.rs",
    "crates/wear/src/library/cache.rs",
];

const IMPURE: [&str; 9] = [
    "std::env",
    "std::fs",
    "std::net",
    "SystemTime",
    "Instant::",
    "Timestamp::now",
    "rand::rng(",
    "thread_rng",
    "from_os_rng",
];

#[test]
fn a_module_names_only_modules_below_it() {
    let mut wrong = Vec::new();
    for (folder, modules) in MODULES {
        let names: Vec<&str> = modules.iter().map(|(name, _)| *name).collect();
        for (module, allowed) in modules {
            for path in rust_files(&root().join(folder).join(module)) {
                let depth = depth_in(&root().join(folder), &path);
                for named in named_at_the_top(&code(&path), depth) {
                    if named != *module
                        && names.contains(&named.as_str())
                        && !allowed.contains(&named.as_str())
                    {
                        wrong.push(format!("{} names {named}", path.display()));
                    }
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_module_is_in_the_table() {
    for (folder, modules) in MODULES {
        for entry in fs::read_dir(root().join(folder)).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                let name = path.file_name().unwrap().to_str().unwrap();
                assert!(
                    modules.iter().any(|(module, _)| *module == name),
                    "{folder}/{name} is not in the table"
                );
            }
        }
    }
}

#[test]
fn pure_code_has_no_clock_environment_chance_or_files() {
    let mut wrong = Vec::new();
    for folder in PURE {
        for path in rust_files(&root().join(folder)) {
            if FILES.iter().any(|file| path.ends_with(file)) {
                continue;
            }
            let text = code(&path);
            let uses = IMPURE.iter().filter(|word| text.contains(*word));
            wrong.extend(uses.map(|word| format!("{} uses {word}", path.display())));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_minimum_rust_version_is_consistent() {
    let table =
        |name: &str| -> toml::Table { fs::read_to_string(root().join(name)).unwrap().parse().unwrap() };
    let manifest = table("Cargo.toml");
    let oldest = manifest["workspace"]["package"]["rust-version"].as_str().unwrap();
    let contributing = fs::read_to_string(root().join("CONTRIBUTING.md")).unwrap();
    assert!(
        contributing.contains(&format!("({oldest} or later)"))
            && contributing.contains(&format!("cargo +{oldest} check"))
    );
    assert_eq!(env!("CARGO_PKG_RUST_VERSION"), oldest, "every package takes that of the workspace");
    let toolchain = table("rust-toolchain.toml");
    let channel = toolchain["toolchain"]["channel"].as_str().unwrap();
    let number =
        |version: &str| -> Option<Vec<u32>> { version.split('.').map(|part| part.parse().ok()).collect() };
    assert!(channel == "stable" || number(channel) >= number(oldest), "{channel} is older than {oldest}");
}

#[test]
fn module_paths_are_found_in_every_spelling() {
    let text =
        "use crate::{store::{Row, service}, asset};\nuse crate::http;\nlet x = super::super::cli::run();";
    assert_eq!(named_at_the_top(text, 2), ["store", "asset", "http", "cli"]);
    assert_eq!(named_at_the_top("use super::{batch, crew};", 2), [""; 0]);
    assert_eq!(named_at_the_top("use super::store::Row;", 1), ["store"]);
}

pub(super) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Returns every Rust file below a folder, except files of unit tests.
pub(super) fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut folders = vec![folder.to_owned()];
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
                files.push(path);
            }
        }
    }
    assert!(!files.is_empty(), "{} has no Rust files", folder.display());
    let texts: String = files.iter().map(|path| fs::read_to_string(path).unwrap()).collect();
    files.retain(|path| {
        let stem = path.file_stem().unwrap().to_string_lossy();
        !texts.contains(&format!("#[cfg(test)]\nmod {stem};"))
    });
    files
}

/// Returns a file's text without its unit tests.
pub(super) fn code(path: &Path) -> String {
    let text = fs::read_to_string(path).unwrap();
    text.split("#[cfg(test)]\nmod tests").next().unwrap_or_default().to_owned()
}

/// Returns the depth of a file's module below the crate root.
fn depth_in(source: &Path, file: &Path) -> usize {
    let module = file.strip_prefix(source).unwrap().with_extension("");
    module.iter().filter(|part| *part != "mod").count()
}

/// Returns the top-level modules that a text uses, by `crate::` or by a chain of `super::` that reaches the
/// root.
fn named_at_the_top(text: &str, depth: usize) -> Vec<String> {
    let to_the_root = "super::".repeat(depth);
    let roots = ["crate::", to_the_root.as_str()];
    let mut places: Vec<(usize, &str)> = roots
        .iter()
        .flat_map(|root| text.match_indices(root).map(|(at, root)| (at, &text[at + root.len()..])))
        .collect();
    places.sort_by_key(|(at, _)| *at);
    places.iter().flat_map(|(_, rest)| first_names(rest)).collect()
}

/// Returns the first name of a path, or those of a group in braces.
fn first_names(path: &str) -> Vec<String> {
    let name = |text: &str| -> String {
        text.trim_start().chars().take_while(|c| c.is_ascii_lowercase() || *c == '_').collect()
    };
    let Some(group) = path.strip_prefix('{') else {
        return vec![name(path)];
    };
    let mut names = vec![name(group)];
    let mut open = 0;
    for (at, character) in group.char_indices() {
        match character {
            '{' => open += 1,
            '}' if open == 0 => break,
            '}' => open -= 1,
            ',' if open == 0 => names.push(name(&group[at + 1..])),
            _ => {}
        }
    }
    names.retain(|name| !name.is_empty());
    names
}
