//! Commands that simulate gear pairs, and those that evaluate the estimate.

pub(super) mod ensemble;
pub(super) mod evaluate;
pub(super) mod figures;
pub(super) mod library;
pub(super) mod model;
pub(super) mod pair_file;
mod plot;
mod recorded_runs;
mod score_table;
pub(super) mod simulate;
