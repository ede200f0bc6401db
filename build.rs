//! Compiles the message schema: Rust types for the codecs, and the descriptor set that MCAP files carry as their schema.

use std::error::Error;
use std::path::PathBuf;

const SCHEMA: &str = "flankwatch/v1/vibration.proto";

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=proto");
    println!("cargo:rerun-if-changed=build.rs");
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    let mut compiler = protox::Compiler::new(["proto"])?;
    compiler.include_imports(true).open_file(SCHEMA)?;
    std::fs::write(out.join("vibration.fds"), compiler.encode_file_descriptor_set())?;
    compiler.include_source_info(true);
    prost_build::Config::new().compile_fds(compiler.file_descriptor_set())?;
    Ok(())
}
