//! Checks that the generated Rust types and descriptor set match `proto/`.
//!
//! After a change of a schema, `FLANKWATCH_GENERATE=1 cargo test -p flankwatch-recording --test generated`
//! writes them anew.

#![cfg(test)]

use std::fs;
use std::path::{Path, PathBuf};

/// Each schema, the file of its Rust types and that of its descriptor set.
const SCHEMAS: [(&str, &str, Option<&str>); 2] = [
    (
        "flankwatch/v1/vibration.proto",
        "crates/recording/src/message/vibration.rs",
        Some("crates/recording/src/message/vibration.fds"),
    ),
    ("flankwatch/v1/work.proto", "src/cluster/message/work.rs", None),
];

#[test]
fn generated_files_are_up_to_date() {
    for (schema, types, descriptors) in SCHEMAS {
        let mut compiler = protox::Compiler::new([root().join("proto")]).unwrap();
        compiler.include_imports(true).open_file(schema).unwrap();
        if let Some(descriptors) = descriptors {
            check(descriptors, &compiler.encode_file_descriptor_set());
        }
        compiler.include_source_info(true);
        check(types, rust_types(&compiler).as_bytes());
    }
}

fn rust_types(compiler: &protox::Compiler) -> String {
    let folder = tempfile::tempdir().unwrap();
    prost_build::Config::new().out_dir(folder.path()).compile_fds(compiler.file_descriptor_set()).unwrap();
    fs::read_to_string(folder.path().join("flankwatch.v1.rs")).unwrap()
}

fn check(file: &str, fresh: &[u8]) {
    let path = root().join(file);
    if std::env::var_os("FLANKWATCH_GENERATE").is_some() {
        return fs::write(path, fresh).unwrap();
    }
    let kept = fs::read(path).unwrap_or_default();
    assert!(kept == fresh, "{file} is stale: run this test with FLANKWATCH_GENERATE=1");
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}
