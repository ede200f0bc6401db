//! The description of a monitored asset ([`AssetSpec`]) and one analysed segment of its vibration
//! ([`Segment`]).

mod alarm_rules;
mod analysis;
mod asset_id;
mod bearing;
mod error;
mod gear_spec;
mod integer_pair;
mod json_name;
mod location;
mod operating_bin;
mod other_mesh;
mod segment;
mod shaft;
mod spec;
mod stream_spec;
mod velocity_zones;
mod wear_limits;

pub use asset_id::AssetId;
pub use bearing::BearingSpec;
pub use error::AssetError;
pub use gear_spec::GearSpec;
pub(crate) use json_name::{from_json_name, json_name};
pub(crate) use location::MAX_UNIT_BYTES;
pub use location::{Location, MeasuringPoint};
pub use operating_bin::OperatingBin;
pub use other_mesh::{MAX_ON_ONE_SENSOR, OtherMeshSpec};
pub use segment::{RawReference, Segment, SegmentId};
pub use shaft::ShaftSpec;
pub use spec::{AssetSpec, BaselineSpec, SensorSpec};
pub use stream_spec::{DEFAULT_STREAM, OnAlarmSpec, SteadySpec, StreamSpec};
pub use velocity_zones::{MachineClass, VelocityZone, VelocityZones};
pub use wear_limits::WearLimits;
