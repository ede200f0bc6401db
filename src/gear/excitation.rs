//! Mesh stiffness and transmission error as functions of the mesh phase, quick to look up.

use super::GearPair;
use super::dynamics::Excitation;
use super::mesh_cycle::CyclePiece;
use super::transmission_error::short_period_m;

/// Excitation over a piece of the mesh period: a table of value and rise of k and of e to the next place.
#[derive(Debug)]
pub(super) struct ExcitationPiece {
    /// Start and end in mesh periods.
    pub(super) start: f64,
    pub(super) end: f64,
    places_per_period: f64,
    table: Vec<[f64; 4]>,
}

impl ExcitationPiece {
    pub(super) fn new(piece: &CyclePiece, pair: &GearPair) -> Self {
        let count = piece.uste_rad.len() - 1;
        let places_per_period = count as f64 / (piece.end - piece.start);
        let base_m = pair.gears[1].base_radius_mm * 1e-3;
        let at = |i: usize| {
            let short = short_period_m(&pair.spec.errors, piece.start + i as f64 / places_per_period);
            [piece.stiffness_n_per_m[i], base_m * piece.uste_rad[i] + short]
        };
        let table = (0..count)
            .map(|i| {
                let ([k, e], [next_k, next_e]) = (at(i), at(i + 1));
                [k, next_k - k, e, next_e - e]
            })
            .collect();
        Self {
            end: piece.end,
            start: piece.start,
            places_per_period,
            table,
        }
    }

    #[inline]
    /// At a place in mesh periods.
    pub(super) fn at(&self, phase: f64) -> Excitation {
        let place = (phase - self.start) * self.places_per_period;
        let cell = (place as usize).min(self.table.len() - 1);
        let [k, k_rise, e, e_rise] = self.table[cell];
        let part = place - cell as f64;
        Excitation {
            stiffness: k + part * k_rise,
            error: e + part * e_rise,
        }
    }
}
