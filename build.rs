//! Compiles the message schema: Rust types for the codecs, and the descriptor set that MCAP files carry as their schema.

use std::error::Error;
use std::path::{Path, PathBuf};

const SCHEMA: &str = "flankwatch/v1/vibration.proto";

const WORK_SCHEMA: &str = "flankwatch/v1/work.proto";

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=proto");
    println!("cargo:rerun-if-changed=build.rs");
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    let mut compiler = protox::Compiler::new(["proto"])?;
    compiler.include_imports(true).open_file(SCHEMA)?;
    std::fs::write(out.join("vibration.fds"), compiler.encode_file_descriptor_set())?;
    compiler.include_source_info(true);
    prost_build::Config::new().compile_fds(compiler.file_descriptor_set())?;
    if std::env::var_os("CARGO_FEATURE_CLUSTER").is_some() {
        compile_work(&out.join("work"))?;
    }
    Ok(())
}

/// The messages between the processes of a cluster, in a folder of their own: they are no part of what a recording says.
fn compile_work(out: &Path) -> Result<(), Box<dyn Error>> {
    std::fs::create_dir_all(out)?;
    let mut compiler = protox::Compiler::new(["proto"])?;
    compiler.include_source_info(true).open_file(WORK_SCHEMA)?;
    prost_build::Config::new()
        .out_dir(out)
        .compile_fds(compiler.file_descriptor_set())?;
    Ok(())
}
