//! Levels of records that a waterfall has shown, kept in memory.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use serde::{Deserialize, Serialize};

use crate::asset::SegmentId;

/// Values that are kept in memory, 4 bytes each.
const MAX_VALUES: usize = 2_000_000;

/// What the cells are laid out over.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum Axis {
    /// Frequency in hertz.
    #[default]
    Hz,
    /// Orders of the driving shaft: frequency over each record's own shaft speed.
    Orders,
}

/// How a spectrum is cut into cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Grid {
    pub(super) axis: Axis,
    pub(super) cells: usize,
    /// Bits of the end of the last cell, so that grids compare.
    pub(super) end_bits: u64,
}

impl Grid {
    pub(super) fn end(self) -> f64 {
        f64::from_bits(self.end_bits)
    }
}

/// The levels of one record's cells.
pub(super) type Line = Arc<[f32]>;

/// Reduced spectra of records, which never change, so that a look again costs only what has come since.
#[derive(Debug, Default)]
pub(super) struct LineCache {
    kept: Mutex<HashMap<(SegmentId, Grid), Line>>,
}

impl LineCache {
    pub(super) fn get(&self, segment: &SegmentId, grid: Grid) -> Option<Line> {
        let kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.get(&(segment.clone(), grid)).cloned()
    }

    pub(super) fn keep(&self, segment: SegmentId, grid: Grid, line: Line) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if (kept.len() + 1) * grid.cells > MAX_VALUES {
            kept.clear();
        }
        kept.insert((segment, grid), line);
    }
}
