//! The cause of a failure to store a record.

use crate::service::ServiceError;

/// The cause of a failure to store a record, which decides what happens to the record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FailureCause {
    /// Something else is unavailable, full or in conflict: the record is retried until that is resolved.
    External,
    /// Possibly the record itself: it is retried a few times.
    Uncertain,
    /// The record itself: it can never be stored.
    Record,
}

impl From<&ServiceError> for FailureCause {
    fn from(error: &ServiceError) -> Self {
        match error {
            ServiceError::Busy { .. } | ServiceError::DescriptionChanged(_) | ServiceError::File { .. } => {
                Self::External
            }
            // Errors of a database, an object store or a network do not prove that a record is at fault.
            ServiceError::Store(error) if !error.may_be_caused_by_record() => Self::External,
            ServiceError::Recording(error) if error.is_full() => Self::External,
            ServiceError::Recording(_)
            | ServiceError::Field { .. }
            | ServiceError::QueuedRecordMismatch { .. } => Self::Record,
            _ => Self::Uncertain,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::SegmentId;
    use crate::store::StoreError;

    #[test]
    fn only_proven_causes_are_attributed_to_the_record() {
        let field =
            ServiceError::Field { field: "start_time", value: "yesterday".to_owned(), expected: "a time" };
        let queued_otherwise = ServiceError::QueuedRecordMismatch {
            found: SegmentId("a".to_owned()),
            expected: SegmentId("b".to_owned()),
        };
        for error in [field, queued_otherwise] {
            assert_eq!(FailureCause::from(&error), FailureCause::Record, "{error}");
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
            assert_eq!(FailureCause::from(&error), FailureCause::External, "{error}");
        }
        let missing = ServiceError::Store(StoreError::ObjectMissing("ab".to_owned()));
        for error in [missing, ServiceError::WorkerLost("analyse")] {
            assert_eq!(FailureCause::from(&error), FailureCause::Uncertain, "{error}");
        }
    }
}
