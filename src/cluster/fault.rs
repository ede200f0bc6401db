//! Whose fault it is that a record could not be stored.

use crate::service::ServiceError;

/// How a record that could not be stored is to be treated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fault {
    /// Something else is away, full or in the way: the record is held until that is over.
    Elsewhere,
    /// Perhaps the record's own: it is tried some more times.
    Doubtful,
    /// The record's own: it can never be stored.
    Own,
}

impl From<&ServiceError> for Fault {
    fn from(error: &ServiceError) -> Self {
        match error {
            ServiceError::Busy { .. } | ServiceError::DescriptionChanged(_) | ServiceError::File { .. } => {
                Self::Elsewhere
            }
            // What a database, an object store or a network says is no proof against a record.
            ServiceError::Store(error) if !error.may_be_caused_by_record() => Self::Elsewhere,
            ServiceError::Recording(error) if error.is_full() => Self::Elsewhere,
            ServiceError::Recording(_)
            | ServiceError::Field { .. }
            | ServiceError::QueuedRecordMismatch { .. } => Self::Own,
            _ => Self::Doubtful,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::SegmentId;
    use crate::store::StoreError;

    #[test]
    fn only_what_is_proven_is_the_records_own() {
        let own =
            ServiceError::Field { field: "start_time", value: "yesterday".to_owned(), expected: "a time" };
        let queued_otherwise = ServiceError::QueuedRecordMismatch {
            found: SegmentId("a".to_owned()),
            expected: SegmentId("b".to_owned()),
        };
        for error in [own, queued_otherwise] {
            assert_eq!(Fault::from(&error), Fault::Own, "{error}");
        }
        let away = std::io::Error::other("connection reset");
        let full = ServiceError::File {
            action: "write",
            path: "scratch".into(),
            source: std::io::ErrorKind::StorageFull.into(),
        };
        let bucket = StoreError::Bucket { action: "read", name: "raw/ab".to_owned(), source: Box::new(away) };
        let lost = StoreError::Database(sqlx::Error::Io(std::io::ErrorKind::ConnectionReset.into()));
        for error in [full, bucket.into(), lost.into(), StoreError::Outdated("the channel").into()] {
            assert_eq!(Fault::from(&error), Fault::Elsewhere, "{error}");
        }
        let missing = ServiceError::Store(StoreError::ObjectMissing("ab".to_owned()));
        for error in [missing, ServiceError::WorkerLost("analyse")] {
            assert_eq!(Fault::from(&error), Fault::Doubtful, "{error}");
        }
    }
}
