//! The messages of `proto/flankwatch/v1/vibration.proto` and their descriptor set.
//!
//! `message/vibration.rs` and `message/vibration.fds` are generated from it, as described in
//! `tests/generated.rs`.

/// Full name of the waveform message's schema.
pub(crate) const WAVEFORM_SCHEMA: &str = "flankwatch.v1.WaveformBlock";

/// Full name of the operating point message's schema.
pub(crate) const OPERATING_POINT_SCHEMA: &str = "flankwatch.v1.OperatingPoint";

/// Full name of the tachometer message's schema.
pub(crate) const TACHOMETER_SCHEMA: &str = "flankwatch.v1.Tachometer";

/// The encoded `google.protobuf.FileDescriptorSet`: the schema that MCAP files carry.
pub(crate) const DESCRIPTOR_SET: &[u8] = include_bytes!("message/vibration.fds");

#[allow(missing_docs, unreachable_pub)]
mod generated {
    include!("message/vibration.rs");
}

pub use generated::{
    AlarmState, Indicators, OperatingPoint, Quality, Spectrum, Tachometer, WaveformBlock, WearEstimate,
};
