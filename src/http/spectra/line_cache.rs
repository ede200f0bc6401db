//! An in-memory cache of spectrum levels for waterfalls.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use serde::{Deserialize, Serialize};

use crate::asset::SegmentId;

/// Maximum number of cached values, 4 bytes each.
const MAX_VALUES: usize = 2_000_000;

/// The horizontal axis of the cells.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Axis {
    /// Frequency in hertz.
    #[default]
    Hz,
    /// Orders of the driving shaft: frequency relative to each record's shaft speed.
    Orders,
}

/// The division of a spectrum into cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct Grid {
    pub(crate) axis: Axis,
    pub(crate) cells: usize,
    /// Bits of the end of the last cell, so that grids can be compared.
    pub(crate) end_bits: u64,
}

impl Grid {
    pub(crate) fn end(self) -> f64 {
        f64::from_bits(self.end_bits)
    }
}

/// The levels of one record's cells.
pub(crate) type Line = Arc<[f32]>;

/// Reduced spectra of records. They never change, so a repeated request computes only new records.
#[derive(Debug, Default)]
pub(crate) struct LineCache {
    entries: Mutex<HashMap<(SegmentId, Grid), Line>>,
}

impl LineCache {
    pub(crate) fn get(&self, segment: &SegmentId, grid: Grid) -> Option<Line> {
        let entries = self.entries.lock().unwrap_or_else(PoisonError::into_inner);
        entries.get(&(segment.clone(), grid)).cloned()
    }

    pub(crate) fn insert(&self, segment: SegmentId, grid: Grid, line: Line) {
        let mut entries = self.entries.lock().unwrap_or_else(PoisonError::into_inner);
        if (entries.len() + 1) * grid.cells > MAX_VALUES {
            entries.clear();
        }
        entries.insert((segment, grid), line);
    }
}
