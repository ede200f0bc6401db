//! Mesh stiffness and transmission error as functions of the mesh phase in fast lookup tables, for several
//! states in parallel.

use super::mesh_cycle::CyclePiece;
use super::{GearPair, MeshCycle};

/// Mesh stiffness in N/m and transmission error in m at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Excitation {
    pub(super) stiffness: f64,
    pub(super) error: f64,
}

/// Number of cells of the mesh period. Within one, k and e are linear unless a piece ends there.
const CELLS: usize = 1024;

/// Excitation over a piece of the mesh period: for each cell that it covers, the start, and k, its slope, e
/// and its slope there.
#[derive(Debug)]
pub(super) struct ExcitationPiece {
    /// Start and end in mesh periods.
    pub(super) start: f64,
    pub(super) end: f64,
    first: usize,
    cells: Vec<Cell>,
}

/// Start of a linear part in cells, with k in N/m and e in m there and their increase over a cell.
#[derive(Debug, Clone, Copy)]
struct Cell {
    start: f64,
    stiffness: [f64; 2],
    error: [f64; 2],
}

impl ExcitationPiece {
    fn new(piece: &CyclePiece, pair: &GearPair) -> Self {
        let count = piece.uste_rad.len() - 1;
        let places_per_period = count as f64 / (piece.end - piece.start);
        let base_m = pair.gears[1].base_radius_mm * 1e-3;
        let at = |phase: f64| {
            let place = ((phase - piece.start) * places_per_period).clamp(0.0, count as f64);
            let cell = (place as usize).min(count - 1);
            let between =
                |values: &[f64]| values[cell] + (place - cell as f64) * (values[cell + 1] - values[cell]);
            let error = base_m * between(&piece.uste_rad) + pair.errors.short_period_m(phase);
            [between(&piece.stiffness_n_per_m), error]
        };
        let cells = CELLS as f64;
        let first = ((piece.start * cells) as usize).min(CELLS - 1);
        let last = ((piece.end * cells).ceil() as usize).clamp(first + 1, CELLS);
        let cell = |cell: usize| {
            let (start, end) =
                ((cell as f64).max(piece.start * cells), (cell as f64 + 1.0).min(piece.end * cells));
            let ([k, e], [next_k, next_e]) = (at(start / cells), at(end / cells));
            let width = (end - start).max(f64::MIN_POSITIVE);
            Cell { start, stiffness: [k, (next_k - k) / width], error: [e, (next_e - e) / width] }
        };
        Self { start: piece.start, end: piece.end, first, cells: (first..last).map(cell).collect() }
    }

    /// Returns the excitation at a phase in mesh periods.
    pub(super) fn at(&self, phase: f64) -> Excitation {
        let place = phase * CELLS as f64;
        let cell = &self.cells[(place as usize).saturating_sub(self.first).min(self.cells.len() - 1)];
        let part = place - cell.start;
        Excitation {
            stiffness: cell.stiffness[0] + part * cell.stiffness[1],
            error: cell.error[0] + part * cell.error[1],
        }
    }
}

/// k in N/m and e in m of each lane.
pub(super) type LaneExcitation<const LANES: usize> = [[f64; LANES]; 2];

/// The excitations of several states over the mesh period.
#[derive(Debug)]
pub(super) struct ExcitationLanes<const LANES: usize> {
    /// Pieces by lane.
    pub(super) pieces: Vec<Vec<ExcitationPiece>>,
    /// k, its increase over the cell, e and its increase, by cell.
    cells: Vec<[[f64; LANES]; 4]>,
    /// Lanes in which a piece ends within the cell, as bits.
    cut: Vec<u32>,
}

impl<const LANES: usize> ExcitationLanes<LANES> {
    /// `cycles` has one entry for each lane.
    pub(super) fn new(cycles: &[&MeshCycle], pair: &GearPair) -> Self {
        let mut lanes = Self {
            pieces: Vec::with_capacity(LANES),
            cells: vec![[[0.0; LANES]; 4]; CELLS],
            cut: vec![0; CELLS],
        };
        for (lane, cycle) in cycles.iter().enumerate() {
            let pieces: Vec<ExcitationPiece> =
                cycle.pieces.iter().map(|piece| ExcitationPiece::new(piece, pair)).collect();
            for piece in &pieces {
                for (i, cell) in piece.cells.iter().enumerate() {
                    let [k, k_rise, e, e_rise] = &mut lanes.cells[piece.first + i];
                    [k[lane], k_rise[lane]] = cell.stiffness;
                    [e[lane], e_rise[lane]] = cell.error;
                }
                if pieces.len() > 1 {
                    // At both ends of the piece, and in both cells if it ends between two.
                    for end in [piece.start, piece.end] {
                        let place = end * CELLS as f64;
                        for cell in [(place - 1e-6).floor(), (place + 1e-6).floor()] {
                            lanes.cut[(cell + CELLS as f64) as usize % CELLS] |= 1 << lane;
                        }
                    }
                }
            }
            lanes.pieces.push(pieces);
        }
        lanes
    }

    /// Returns the lanes with a piece end near the range from a phase on over `width` mesh periods.
    #[inline]
    pub(super) fn cut_within(&self, phase: f64, width: f64) -> u32 {
        let first = (phase * CELLS as f64) as usize;
        let last = ((phase + width) * CELLS as f64) as usize;
        if last - first >= CELLS {
            return u32::MAX;
        }
        (first..=last).fold(0, |lanes, cell| lanes | self.cut[cell % CELLS])
    }

    /// Returns the excitation at a phase from 0 to 1. A lane's values are valid if its cell is not cut.
    #[inline(always)]
    pub(super) fn at(&self, phase: f64) -> LaneExcitation<LANES> {
        let place = phase * CELLS as f64;
        let cell = (place as usize).min(CELLS - 1);
        let part = place - cell as f64;
        let [k, k_rise, e, e_rise] = &self.cells[cell];
        let mut values = [[0.0; LANES]; 2];
        for lane in 0..LANES {
            values[0][lane] = k[lane] + part * k_rise[lane];
            values[1][lane] = e[lane] + part * e_rise[lane];
        }
        values
    }
}
