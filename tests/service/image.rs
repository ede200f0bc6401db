//! The image has every file that the program is built from.

use std::fs;
use std::path::{Component, Path, PathBuf};
use std::process::Command;

/// What of the repository goes into the image: everything is left out but these.
fn taken() -> Vec<String> {
    let rules = crate::deploy::text("Dockerfile.dockerignore");
    let mut lines = rules.lines();
    assert_eq!(lines.next(), Some("*"), "what is not named is left out");
    let named = lines.map(|line| {
        line.strip_prefix('!').unwrap_or_else(|| panic!("{line:?} leaves out again what was taken"))
    });
    named.map(str::to_owned).collect()
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Every file at or below a path.
fn files(path: &Path) -> Vec<PathBuf> {
    if path.is_file() {
        return vec![path.to_owned()];
    }
    let entries = fs::read_dir(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    entries.flat_map(|entry| files(&entry.unwrap().path())).collect()
}

/// The files that a source includes, by paths from the root of the repository.
fn included(source: &Path) -> Vec<PathBuf> {
    let text = fs::read_to_string(source).unwrap();
    let mut found = Vec::new();
    for name in ["include_str!(", "include_bytes!(", "include!("] {
        for (at, _) in text.match_indices(name) {
            // Others are put together by a macro, of names in the same folder.
            let Some(path) = text[at + name.len()..].trim_start().strip_prefix('"') else {
                continue;
            };
            let path = source.parent().unwrap().join(&path[..path.find('"').unwrap()]);
            let mut plain = PathBuf::new();
            for part in path.components() {
                match part {
                    Component::ParentDir => assert!(plain.pop()),
                    part => plain.push(part),
                }
            }
            found.push(plain.strip_prefix(root()).unwrap().to_owned());
        }
    }
    found
}

#[test]
fn what_sources_include_is_in_the_image() {
    let taken = taken();
    let mut count = 0;
    for source in taken.iter().flat_map(|name| files(&root().join(name))) {
        if source.extension().is_none_or(|extension| extension != "rs") {
            continue;
        }
        for file in included(&source) {
            count += 1;
            assert!(root().join(&file).is_file(), "{}: there is no {}", source.display(), file.display());
            let is_taken = taken.iter().any(|name| file.starts_with(name));
            assert!(is_taken, "{} includes {}, which the image leaves out", source.display(), file.display());
        }
    }
    assert!(count > 20, "{count} files are included");
}

/// Cargo reads all manifests before it builds anything, and misses what they name.
#[test]
fn cargo_finds_all_that_manifests_name_in_the_image() {
    let image = tempfile::tempdir().unwrap();
    for name in taken() {
        for file in files(&root().join(name)) {
            let to = image.path().join(file.strip_prefix(root()).unwrap());
            fs::create_dir_all(to.parent().unwrap()).unwrap();
            fs::copy(&file, &to).unwrap();
        }
    }
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    let said = Command::new(cargo)
        .args(["metadata", "--locked", "--offline", "--no-deps", "--format-version", "1"])
        .current_dir(image.path())
        .output()
        .unwrap();
    assert!(said.status.success(), "{}", String::from_utf8_lossy(&said.stderr));
}
