//! What is monitored ([`AssetSpec`]) and one analysed stretch of its vibration ([`Segment`]).

mod alarm_rules;
mod operating_bin;
mod other_mesh;
mod pair_of_numbers;
mod place;
mod segment;
mod spec;
mod stream_spec;

pub use operating_bin::OperatingBin;
pub use other_mesh::{MAX_ON_ONE_SENSOR, OtherMeshSpec};
pub use place::{Location, MeasuringPoint};
pub use segment::{RawReference, Segment, SegmentId};
pub use spec::{AssetError, AssetId, AssetSpec, BaselineSpec, GearSpec, SensorSpec, WearLimits};
pub use stream_spec::StreamSpec;
