//! Lists the dashboard's files for `src/http/dashboard.rs`.

use std::path::Path;
use std::{env, fs, io};

fn main() -> io::Result<()> {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=src/http/dashboard");
    let names: io::Result<Vec<_>> =
        fs::read_dir("src/http/dashboard")?.map(|entry| Ok(entry?.file_name())).collect();
    let mut names = names?;
    names.sort();
    // Not absolute: another copy of these sources may use the same target folder.
    let root = r#"env!("CARGO_MANIFEST_DIR"), "/src/http/dashboard/""#;
    let file =
        |name| format!("StaticFile {{ name: {name:?}, bytes: include_bytes!(concat!({root}, {name:?})) }}");
    let files: Vec<String> = names.iter().map(file).collect();
    let out = env::var_os("OUT_DIR").unwrap_or_default();
    fs::write(Path::new(&out).join("dashboard_files.rs"), format!("&[{}]", files.join(",\n")))
}
