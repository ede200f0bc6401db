//! Growth of wear: it never decreases, and its rate is part of the filter's state.
//!
//! By Archard's law, wear grows with load, sliding and turns, times an unknown coefficient. The unit of
//! growth is the time between two records of the baseline, or a part of the machine's age, at the described
//! load (`growth_clock.rs`); the rate in µm per unit represents the coefficient.

use crate::library::{DEPTHS, REPORTED, end_um};

/// Rates in parts of the library's end per unit: zero, and from very slow to a gear that fails within fifty
/// records.
const RATE_PARTS: [f64; RATES] = [0.0, 4e-4, 2e-3, 6.5e-3, 2e-2];

/// Returns the rates in µm per unit for these depths.
pub(super) fn rates_um(depths_um: &[f64]) -> [f64; RATES] {
    RATE_PARTS.map(|part| part * end_um(depths_um))
}

/// Number of rates.
pub(super) const RATES: usize = 5;

/// Prior probabilities of the rates: most machines do not wear most of the time.
pub(super) const PRIOR: [f32; RATES] = [0.3, 0.2, 0.2, 0.2, 0.1];

/// Probability per unit that the rate is redrawn from its prior.
const CHANGES: f64 = 0.025;

/// How likely wear jumps to any greater depth: a tooth was damaged, or the oil was lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Jumps {
    /// Records come as usual and agree with the estimate.
    Rare,
    /// Records are missing, so a jump would have gone unseen.
    InGap,
    /// Several records in a row are best explained by greater depths than the interval holds.
    Indicated,
}

impl Jumps {
    /// Probability per unit of growth.
    fn per_unit(self) -> f64 {
        match self {
            Self::Rare => 0.0005,
            Self::InGap => 0.01,
            Self::Indicated => 0.02,
        }
    }
}

/// What passes between two records.
#[derive(Debug, Clone, Copy)]
pub(super) struct Elapsed {
    /// Units of growth.
    pub(super) units: f64,
    /// Factor by which a unit of growth becomes longer, at least 1.
    pub(super) lengthening: f64,
    pub(super) jumps: Jumps,
}

/// Longest interval in units that is computed at a constant rate.
const MAX_PART: f64 = 5.0;

/// Largest number of steps of one interval.
const MAX_STEPS: usize = 256;

/// Growth on the depths of an ensemble.
#[derive(Debug, Clone, Default)]
pub(super) struct Growth {
    /// Distance in µm to the next depth.
    widths_um: Vec<f32>,
    /// The smallest of them.
    least_um: f64,
    rates_um: [f64; RATES],
}

impl Growth {
    /// Creates the growth on these depths in µm.
    pub(super) fn on(depths_um: &[f64]) -> Self {
        let widths_um: Vec<f32> = depths_um.windows(2).map(|two| (two[1] - two[0]) as f32).collect();
        let least_um = widths_um.iter().copied().fold(f32::INFINITY, f32::min).into();
        Self { widths_um, least_um, rates_um: rates_um(depths_um) }
    }

    /// Advances probabilities by rate and depth, in blocks of [`RATES`] × [`DEPTHS`], to the next record.
    #[inline(always)]
    pub(super) fn advance(&self, blocks: &mut [f32], elapsed: Elapsed) {
        let Elapsed { units, lengthening, jumps } = elapsed;
        if lengthening > 1.0 {
            self.lengthen_unit(blocks, lengthening);
        }
        // The rate may change within a long interval.
        let parts = (units / MAX_PART).ceil().max(1.0);
        for _ in 0..parts as usize {
            self.advance_part(blocks, units / parts, jumps);
        }
    }

    /// Keeps the growth per time while a unit becomes longer by a factor: a part of each rate's probability
    /// moves to the next higher rate.
    #[inline(always)]
    fn lengthen_unit(&self, blocks: &mut [f32], factor: f64) {
        let ratio = |rate: usize| self.rates_um[rate + 1] / self.rates_um[rate];
        for block in blocks.as_chunks_mut::<{ RATES * DEPTHS }>().0 {
            let (rows, _) = block.as_chunks_mut::<DEPTHS>();
            // The first rate is that of no growth, and the last one has none above it.
            for rate in (1..RATES - 1).rev() {
                let part = (factor.ln() / ratio(rate).ln()).min(1.0) as f32;
                let (lower, higher) = rows.split_at_mut(rate + 1);
                for (from, to) in lower[rate].iter_mut().zip(&mut higher[0]) {
                    let moved = part * *from;
                    *from -= moved;
                    *to += moved;
                }
            }
        }
    }

    #[inline(always)]
    fn advance_part(&self, blocks: &mut [f32], units: f64, jumps: Jumps) {
        let moves = self.rates_um.map(|rate_um| self.moves(rate_um * units));
        let within = |per_unit: f64| (1.0 - (1.0 - per_unit).powf(units)) as f32;
        let redrawn = within(CHANGES);
        let jumping = within(jumps.per_unit());
        for block in blocks.as_chunks_mut::<{ RATES * DEPTHS }>().0 {
            let (rows, _) = block.as_chunks_mut::<DEPTHS>();
            for (row, (steps, moving)) in rows.iter_mut().zip(&moves) {
                (0..*steps).for_each(|_| step(row, moving));
            }
            self.jump(rows, jumping);
            let mut total = [0.0_f32; DEPTHS];
            for row in rows.iter() {
                (0..DEPTHS).for_each(|depth| total[depth] += redrawn * row[depth]);
            }
            for (row, prior) in rows.iter_mut().zip(PRIOR) {
                for depth in 0..DEPTHS {
                    row[depth] += prior * total[depth] - redrawn * row[depth];
                }
            }
        }
    }

    /// Returns the number of steps for a growth of `mean_um`, and the part of each depth's probability that
    /// moves to the next depth in a step.
    fn moves(&self, mean_um: f64) -> (usize, [f32; DEPTHS]) {
        let mut parts = [0.0; DEPTHS];
        if mean_um <= 0.0 {
            return (0, parts);
        }
        let steps = ((mean_um / (0.8 * self.least_um)).ceil() as usize).clamp(1, MAX_STEPS);
        let each = (mean_um / steps as f64) as f32;
        parts.iter_mut().zip(&self.widths_um).for_each(|(part, width)| *part = (each / width).min(1.0));
        (steps, parts)
    }

    /// Spreads a part of each depth's probability over all greater depths up to the library's end, at all
    /// rates.
    #[inline(always)]
    fn jump(&self, rows: &mut [[f32; DEPTHS]], part: f32) {
        let mut left: f32 = self.widths_um[..REPORTED - 1].iter().sum();
        let mut falling = [0.0_f32; RATES];
        let mut before_um = 0.0;
        for (depth, width_um) in self.widths_um[..REPORTED - 1].iter().enumerate() {
            let each = part / left.max(f32::MIN_POSITIVE);
            for (row, falling) in rows.iter_mut().zip(&mut falling) {
                let value = row[depth];
                row[depth] += *falling * before_um - part * value;
                *falling += each * value;
            }
            left -= width_um;
            before_um = *width_um;
        }
        for (row, falling) in rows.iter_mut().zip(falling) {
            row[REPORTED - 1] += falling * before_um;
        }
    }
}

#[inline(always)]
fn step(row: &mut [f32; DEPTHS], moving: &[f32; DEPTHS]) {
    let leaves: [f32; DEPTHS] = std::array::from_fn(|depth| row[depth] * moving[depth]);
    for depth in 0..DEPTHS {
        row[depth] -= leaves[depth];
    }
    for depth in 1..DEPTHS {
        row[depth] += leaves[depth - 1];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn units(units: f64) -> Elapsed {
        Elapsed { units, lengthening: 1.0, jumps: Jumps::Rare }
    }

    fn grid() -> Vec<f64> {
        (0..DEPTHS).map(|i| 5.0 * i as f64).collect()
    }

    #[test]
    fn probability_is_conserved_and_wear_never_decreases() {
        let growth = Growth::on(&grid());
        let mut block = vec![0.0; RATES * DEPTHS];
        for (rate, prior) in PRIOR.iter().enumerate() {
            block[rate * DEPTHS + 10] = *prior;
        }
        for _ in 0..30 {
            growth.advance(&mut block, units(1.0));
        }
        assert!((block.iter().sum::<f32>() - 1.0).abs() < 1e-4);
        let below: f32 = block.chunks(DEPTHS).map(|row| row[..10].iter().sum::<f32>()).sum();
        assert!(below.abs() < 1e-6);
    }

    #[test]
    fn growth_is_the_rate_times_the_units() {
        let growth = Growth::on(&grid());
        let (steps, moving) = growth.moves(40.0);
        let mut row = [0.0; DEPTHS];
        row[4] = 1.0;
        (0..steps).for_each(|_| step(&mut row, &moving));
        let mean: f64 = row.iter().zip(grid()).map(|(p, um)| f64::from(*p) * um).sum();
        assert!((mean - 60.0).abs() < 1e-3, "{mean}");
    }

    #[test]
    fn growth_per_time_stays_while_a_unit_becomes_longer() {
        let growth = Growth::on(&grid());
        let mut block = vec![0.0_f32; RATES * DEPTHS];
        block[2 * DEPTHS] = 1.0;
        let log_rate = |block: &[f32]| -> f64 {
            let of = |rate: usize| f64::from(block[rate * DEPTHS..(rate + 1) * DEPTHS].iter().sum::<f32>());
            (1..RATES).map(|rate| of(rate) * growth.rates_um[rate].ln()).sum()
        };
        let before = log_rate(&block);
        growth.lengthen_unit(&mut block, 1.2);
        growth.lengthen_unit(&mut block, 1.25);
        assert!((log_rate(&block) - before - 1.5_f64.ln()).abs() < 1e-5);
    }

    #[test]
    fn a_rate_changes_to_those_of_the_prior() {
        let growth = Growth::on(&grid());
        let mut block = vec![0.0_f32; RATES * DEPTHS];
        block[0] = 1.0;
        growth.advance(&mut block, units(1.0));
        let left: f32 = block[..DEPTHS].iter().sum();
        assert!((1.0 - left - 0.025 * 0.7).abs() < 1e-3, "{left}");
    }

    #[test]
    fn a_long_interval_reaches_at_least_as_far_as_many_short_ones() {
        let growth = Growth::on(&grid());
        let start = || {
            let mut block = vec![0.0_f32; RATES * DEPTHS];
            block[3 * DEPTHS] = 1.0;
            block
        };
        let (mut long, mut short) = (start(), start());
        growth.advance(&mut long, units(20.0));
        (0..20).for_each(|_| growth.advance(&mut short, units(1.0)));
        let mean = |block: &[f32]| -> f64 {
            let depths = grid();
            block.iter().enumerate().map(|(i, p)| f64::from(*p) * depths[i % DEPTHS]).sum()
        };
        assert!(
            mean(&long) > mean(&short) && mean(&long) < 3.0 * mean(&short),
            "{} {}",
            mean(&long),
            mean(&short)
        );
    }
}
