//! What is fuzzed; the programs in `fuzz_targets` call it, and so does `tests/model/hostile_bytes.rs` on a
//! stable toolchain.

pub mod entries;
