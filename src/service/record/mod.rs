//! One record: its decoding, identification and analysis, and reading it from its raw bytes once it is
//! stored.

mod analyse;
mod channel_names;
mod channel_units;
mod decode;
mod identify;
mod stored;

pub(crate) use analyse::{analyse, analyse_all};
pub use channel_names::ChannelNames;
pub(crate) use channel_units::{ChannelUnits, units_conflict};
pub use decode::{RecordFormat, SampleFile, SampleFileKind, UploadMetadata};
pub(crate) use decode::{decode_upload, defaults_of, with_unit};
pub(crate) use identify::{
    IdentifiedRecord, check_repeat, check_time, identify_recorded, identify_upload, known_to_all,
};
pub use stored::{BandChoice, LoadedRecord, SegmentEnvelope, StoredRecords};
pub(crate) use stored::{StoredRecord, raw_bytes};
