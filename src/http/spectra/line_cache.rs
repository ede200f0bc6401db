//! An in-memory cache of spectrum levels for waterfalls.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use serde::{Deserialize, Serialize};

use crate::asset::{Segment, SegmentId};

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

impl Axis {
    /// One unit of the axis in hertz for a record; none if it depends on a speed that is unknown.
    pub(crate) fn unit_hz(self, segment: &Segment) -> Option<f64> {
        match self {
            Self::Hz => Some(1.0),
            Self::Orders => segment.shaft_speed.map(|speed| speed.shaft_speed_hz),
        }
    }
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

/// What a line depends on. A record's samples never change, but its shaft speed does with the asset.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(crate) struct LineKey {
    segment: SegmentId,
    grid: Grid,
    unit_hz_bits: u64,
}

impl LineKey {
    pub(crate) fn new(segment: SegmentId, grid: Grid, unit_hz: f64) -> Self {
        Self { segment, grid, unit_hz_bits: unit_hz.to_bits() }
    }
}

/// Reduced spectra of records, so that a repeated request computes only those of new records.
#[derive(Debug, Default)]
pub(crate) struct LineCache {
    entries: Mutex<HashMap<LineKey, Line>>,
}

impl LineCache {
    pub(crate) fn get(&self, key: &LineKey) -> Option<Line> {
        let entries = self.entries.lock().unwrap_or_else(PoisonError::into_inner);
        entries.get(key).cloned()
    }

    pub(crate) fn insert(&self, key: LineKey, line: Line) {
        let mut entries = self.entries.lock().unwrap_or_else(PoisonError::into_inner);
        if (entries.len() + 1) * key.grid.cells > MAX_VALUES {
            entries.clear();
        }
        entries.insert(key, line);
    }
}
