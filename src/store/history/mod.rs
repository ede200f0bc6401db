//! Rows of histories: what the fold of a channel writes, its stored states, and trends over a whole history.

pub(super) mod channel_rows;
pub(super) mod fold_states;
pub(super) mod generations;
pub(super) mod recent_wear;
pub(super) mod trend;
pub(super) mod trend_blocks;
pub(super) mod wear_rows;
