//! What is monitored ([`AssetSpec`]) and one analysed stretch of its vibration ([`Segment`]).

mod alarm_rules;
mod heard_mesh;
mod operating_bin;
mod place;
mod segment;
mod spec;

pub use heard_mesh::{MOST_ON_ONE_SENSOR, OtherMeshSpec};
pub use operating_bin::OperatingBin;
pub use place::{Location, MeasuringPoint};
pub use segment::{RawReference, Segment, SegmentId};
pub use spec::{AssetError, AssetId, AssetSpec, BaselineSpec, GearSpec, SensorSpec, WearLimits};
