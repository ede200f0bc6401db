//! Repeats changes that conflict with those of other processes.

use std::time::Duration;

use super::error::ServiceError;

/// Wait before the first retry; it grows with each retry, so that concurrent changes all get through.
const WAIT: Duration = Duration::from_millis(5);

/// Prepares and commits a change, and again up to `max_retries` times while it conflicts with one of another
/// process. `what` names it in the log.
pub(crate) async fn retry_conflicts<T, F>(
    what: &str,
    max_retries: u32,
    mut change: impl FnMut() -> F,
) -> Result<T, ServiceError>
where
    F: Future<Output = Result<T, ServiceError>>,
{
    let mut tries = 0;
    loop {
        match change().await {
            Err(ServiceError::Store(error)) if error.is_conflict() && tries < max_retries => {
                tries += 1;
                tracing::debug!(%error, tries, "conflict with another process; retrying {what}");
                tokio::time::sleep(WAIT * tries).await;
            }
            outcome => return outcome,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;
    use crate::store::StoreError;

    #[tokio::test]
    async fn conflicts_are_retried_and_other_errors_are_not() {
        let calls = Cell::new(0);
        let outcome = async |conflicts: u32, error: fn() -> StoreError| {
            calls.set(0);
            let change = || {
                calls.set(calls.get() + 1);
                let call = calls.get();
                async move { if call > conflicts { Ok(call) } else { Err(error().into()) } }
            };
            (retry_conflicts("a test", 3, change).await.ok(), calls.get())
        };
        let conflict = || StoreError::Outdated("a description");
        assert_eq!(outcome(0, conflict).await, (Some(1), 1));
        assert_eq!(outcome(3, conflict).await, (Some(4), 4));
        assert_eq!(outcome(4, conflict).await, (None, 4));
        assert_eq!(outcome(1, || StoreError::ObjectMissing(String::new())).await, (None, 1));
    }
}
