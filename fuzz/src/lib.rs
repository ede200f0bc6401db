//! The fuzz entry points, called by the programs in `fuzz_targets`, and by `tests/model/hostile_bytes.rs` on
//! a stable toolchain.

pub mod entries;
