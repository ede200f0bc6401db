//! Rate limiting: a burst of one second's requests, then an even rate.

use std::collections::HashMap;
use std::num::NonZeroU32;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Requests within this time may come at once.
const BURST: Duration = Duration::from_secs(1);

/// The generic cell rate algorithm (ITU-T I.371) for each name.
pub(crate) struct RateLimiter {
    interval: Duration,
    /// Theoretical arrival time of the next request of each name.
    due: Mutex<HashMap<String, Instant>>,
}

impl RateLimiter {
    pub(crate) fn per_second(requests: NonZeroU32) -> Self {
        Self { interval: BURST / requests.get(), due: Mutex::default() }
    }

    /// Counts a request at `now`.
    ///
    /// On error, returns the time until a request would be accepted; this one does not count.
    pub(crate) fn check(&self, name: &str, now: Instant) -> Result<(), Duration> {
        let mut due = self.due.lock().unwrap_or_else(PoisonError::into_inner);
        let next = due.get(name).map_or(now, |due| now.max(*due)) + self.interval;
        let ahead = next - now;
        if ahead > BURST {
            return Err(ahead - BURST);
        }
        due.insert(name.to_owned(), next);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_at_once_and_then_evenly() {
        let limiter = RateLimiter::per_second(NonZeroU32::new(4).unwrap());
        let start = Instant::now();
        let at = |ms: u64| start + Duration::from_millis(ms);
        assert_eq!([0; 4].map(|ms| limiter.check("a", at(ms))), [Ok(()); 4]);
        assert_eq!(limiter.check("a", at(0)), Err(Duration::from_millis(250)));
        assert_eq!(limiter.check("a", at(200)), Err(Duration::from_millis(50)));
        assert_eq!(limiter.check("a", at(250)), Ok(()));
        assert!(limiter.check("a", at(260)).is_err());
        // Other names have their own rate, and an idle one regains a full second's burst.
        assert_eq!(limiter.check("b", at(260)), Ok(()));
        assert_eq!([5000; 4].map(|ms| limiter.check("a", at(ms))), [Ok(()); 4]);
        assert!(limiter.check("a", at(5000)).is_err());
    }
}
