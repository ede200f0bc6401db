//! The cause of a failure to process a record.

use super::error::ServiceError;
use crate::store::StoreError;

/// The cause of a failure to process a record, which decides what happens to the record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FailureCause {
    /// Something else is unavailable, full or in conflict: to be retried until that is resolved.
    External,
    /// Possibly the record itself: to be retried a few times.
    Uncertain,
    /// The record itself: no retry can succeed.
    Record,
}

impl ServiceError {
    /// The cause of a failure to process a record.
    pub fn cause(&self) -> FailureCause {
        match self {
            Self::Busy { .. } | Self::DescriptionChanged(_) | Self::UnitChosen { .. } | Self::File { .. } => {
                FailureCause::External
            }
            // The next attempt takes the stream back, and continues where the other sender stopped.
            Self::StreamTaken | Self::StreamHeld { .. } => FailureCause::External,
            // Errors of a database, an object store or a network do not prove that a record is at fault.
            Self::Store(error) if !error.may_be_caused_by_record() => FailureCause::External,
            Self::Recording(error) if error.is_full() => FailureCause::External,
            Self::Recording(_) | Self::Field { .. } | Self::QueuedRecordMismatch { .. } => {
                FailureCause::Record
            }
            _ => FailureCause::Uncertain,
        }
    }

    /// Whether a stored record can no longer be read from its raw bytes: they were deleted, are lost or
    /// damaged, or cannot be decoded. False if the disk or the network failed, which may pass.
    pub(crate) fn is_record_lost(&self) -> bool {
        self.is_raw_unavailable()
            || match self {
                Self::Recording(_) => self.cause() == FailureCause::Record,
                Self::Store(error) => matches!(error, StoreError::Unexpected { .. }),
                _ => false,
            }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::SegmentId;
    use crate::recording::RecordingError;

    #[test]
    fn only_proven_causes_are_attributed_to_the_record() {
        let field = ServiceError::Field {
            field: "start_time",
            value: "yesterday".to_owned(),
            expected: "a time".into(),
        };
        let queued_otherwise = ServiceError::QueuedRecordMismatch {
            found: SegmentId("a".to_owned()),
            expected: SegmentId("b".to_owned()),
        };
        for error in [field, queued_otherwise] {
            assert_eq!(error.cause(), FailureCause::Record, "{error}");
        }
        let reset = std::io::Error::other("connection reset");
        let full = ServiceError::File {
            action: "write",
            path: "scratch".into(),
            source: std::io::ErrorKind::StorageFull.into(),
        };
        let bucket =
            StoreError::Bucket { action: "read", name: "raw/ab".to_owned(), source: Box::new(reset) };
        let lost = StoreError::Database(sqlx::Error::Io(std::io::ErrorKind::ConnectionReset.into()));
        for error in [full, bucket.into(), lost.into(), StoreError::Outdated("the channel").into()] {
            assert_eq!(error.cause(), FailureCause::External, "{error}");
            assert!(!error.is_record_lost(), "{error}");
        }
        let missing = ServiceError::Store(StoreError::ObjectMissing("ab".to_owned()));
        for error in [missing, ServiceError::WorkerLost("analyse")] {
            assert_eq!(error.cause(), FailureCause::Uncertain, "{error}");
        }
    }

    #[test]
    fn a_record_is_lost_only_with_its_bytes() {
        let name = || "ab".to_owned();
        let damaged = StoreError::ObjectDamaged { expected: name(), found: "cd".to_owned() };
        let lost = [
            ServiceError::RawDeleted(SegmentId(name())),
            StoreError::ObjectMissing(name()).into(),
            damaged.into(),
            RecordingError::NoBytes.into(),
        ];
        for error in lost {
            assert!(error.is_record_lost(), "{error}");
        }
        let failed = std::io::Error::other("input/output error");
        let unread = StoreError::File { action: "read", path: "raw/ab/ab".into(), source: failed };
        let full = RecordingError::Io(std::io::ErrorKind::StorageFull.into());
        for error in [unread.into(), full.into(), ServiceError::WorkerLost("reanalyse a record")] {
            assert!(!error.is_record_lost(), "{error}");
        }
    }
}
