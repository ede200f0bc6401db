//! Lists the dashboard's files for `src/http/dashboard.rs`.

use std::path::Path;
use std::{env, fs, io};

fn main() -> io::Result<()> {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=src/http/dashboard");
    let mut files = Vec::new();
    for entry in fs::read_dir("src/http/dashboard")? {
        let (name, path) = entry.map(|entry| (entry.file_name(), entry.path()))?;
        let path = fs::canonicalize(path)?;
        files.push(format!("StaticFile {{ name: {name:?}, bytes: include_bytes!({path:?}) }}"));
    }
    let out = env::var_os("OUT_DIR").unwrap_or_default();
    fs::write(Path::new(&out).join("dashboard_files.rs"), format!("&[{}]", files.join(",\n")))
}
