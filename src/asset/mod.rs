//! What is monitored ([`AssetSpec`]) and one analysed stretch of its vibration ([`Segment`]).

mod segment;
mod spec;

pub use segment::{RawReference, Segment, SegmentId};
pub use spec::{AssetError, AssetId, AssetSpec, BaselineSpec, GearSpec, SensorSpec, WearLimits};
