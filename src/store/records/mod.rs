//! Rows of records: reading, excluding, removing and thinning them, and their raw objects.

pub(super) mod exclusion;
pub(super) mod latest;
pub(super) mod raw;
pub(super) mod removal;
pub(super) mod results;
pub(super) mod segments;
pub(super) mod thinning;
