//! What is monitored ([`AssetSpec`]) and one analysed stretch of its vibration ([`Segment`]).

mod place;
mod segment;
mod spec;

pub use place::{Location, MeasuringPoint};
pub use segment::{RawReference, Segment, SegmentId};
pub use spec::{AssetError, AssetId, AssetSpec, BaselineSpec, GearSpec, SensorSpec, WearLimits};
