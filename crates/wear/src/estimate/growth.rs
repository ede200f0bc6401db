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

/// Probabilities by depth, of several groups of members side by side.
pub(super) type ByDepth<const L: usize> = [[f32; L]; DEPTHS];

/// The same by rate.
pub(super) type ByRate<const L: usize> = [ByDepth<L>; RATES];

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

    /// Advances probabilities to the next record.
    #[inline(always)]
    pub(super) fn advance<const L: usize>(&self, blocks: &mut [ByRate<L>], elapsed: Elapsed) {
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
    fn lengthen_unit<const L: usize>(&self, blocks: &mut [ByRate<L>], factor: f64) {
        let ratio = |rate: usize| self.rates_um[rate + 1] / self.rates_um[rate];
        for block in blocks {
            // The first rate is that of no growth, and the last one has none above it.
            for rate in (1..RATES - 1).rev() {
                let part = (factor.ln() / ratio(rate).ln()).min(1.0) as f32;
                let (lower, higher) = block.split_at_mut(rate + 1);
                let (lower, higher) = (lower[rate].as_flattened_mut(), higher[0].as_flattened_mut());
                for (from, to) in lower.iter_mut().zip(higher) {
                    let moved = part * *from;
                    *from -= moved;
                    *to += moved;
                }
            }
        }
    }

    #[inline(always)]
    fn advance_part<const L: usize>(&self, blocks: &mut [ByRate<L>], units: f64, jumps: Jumps) {
        let moves = self.rates_um.map(|rate_um| self.moves(rate_um * units));
        let within = |per_unit: f64| (1.0 - (1.0 - per_unit).powf(units)) as f32;
        let redrawn = within(CHANGES);
        let jumping = within(jumps.per_unit());
        for block in blocks {
            for (row, (steps, moving)) in block.iter_mut().zip(&moves) {
                for _ in 0..*steps {
                    step(row, moving);
                }
            }
            self.jump(block, jumping);
            for depth in 0..DEPTHS {
                let mut total = [0.0_f32; L];
                for row in block.iter() {
                    for lane in 0..L {
                        total[lane] += redrawn * row[depth][lane];
                    }
                }
                for (row, prior) in block.iter_mut().zip(PRIOR) {
                    for lane in 0..L {
                        row[depth][lane] += prior * total[lane] - redrawn * row[depth][lane];
                    }
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
    fn jump<const L: usize>(&self, block: &mut ByRate<L>, part: f32) {
        for row in block {
            let mut left: f32 = self.widths_um[..REPORTED - 1].iter().sum();
            let mut falling = [0.0_f32; L];
            let mut before_um = 0.0;
            for (depth, width_um) in self.widths_um[..REPORTED - 1].iter().enumerate() {
                let each = part / left.max(f32::MIN_POSITIVE);
                for (cell, falling) in row[depth].iter_mut().zip(&mut falling) {
                    let value = *cell;
                    *cell += *falling * before_um - part * value;
                    *falling += each * value;
                }
                left -= width_um;
                before_um = *width_um;
            }
            for (cell, falling) in row[REPORTED - 1].iter_mut().zip(falling) {
                *cell += falling * before_um;
            }
        }
    }
}

/// Moves a part of each depth's probability to the next depth.
#[inline(always)]
fn step<const L: usize>(row: &mut ByDepth<L>, moving: &[f32; DEPTHS]) {
    for depth in (1..DEPTHS).rev() {
        let before = row[depth - 1];
        for lane in 0..L {
            row[depth][lane] += before[lane] * moving[depth - 1] - row[depth][lane] * moving[depth];
        }
    }
    row[0].iter_mut().for_each(|cell| *cell -= *cell * moving[0]);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn units(units: f64) -> Elapsed {
        Elapsed { units, lengthening: 1.0, jumps: Jumps::Rare }
    }

    fn start(rate: usize, depth: usize) -> ByRate<1> {
        let mut block = [[[0.0]; DEPTHS]; RATES];
        block[rate][depth] = [1.0];
        block
    }

    fn advance(growth: &Growth, block: &mut ByRate<1>, by: f64) {
        growth.advance(std::slice::from_mut(block), units(by));
    }

    fn total(block: &ByRate<1>) -> f32 {
        block.as_flattened().as_flattened().iter().sum()
    }

    fn grid() -> Vec<f64> {
        (0..DEPTHS).map(|i| 5.0 * i as f64).collect()
    }

    #[test]
    fn probability_is_conserved_and_wear_never_decreases() {
        let growth = Growth::on(&grid());
        let mut block = [[[0.0]; DEPTHS]; RATES];
        for (row, prior) in block.iter_mut().zip(PRIOR) {
            row[10] = [prior];
        }
        for _ in 0..30 {
            advance(&growth, &mut block, 1.0);
        }
        assert!((total(&block) - 1.0).abs() < 1e-4);
        let below: f32 = block.iter().flat_map(|row| row[..10].as_flattened()).sum();
        assert!(below.abs() < 1e-6);
    }

    #[test]
    fn growth_is_the_rate_times_the_units() {
        let growth = Growth::on(&grid());
        let (steps, moving) = growth.moves(40.0);
        let mut row = start(0, 4)[0];
        (0..steps).for_each(|_| step(&mut row, &moving));
        let mean: f64 = row.as_flattened().iter().zip(grid()).map(|(p, um)| f64::from(*p) * um).sum();
        assert!((mean - 60.0).abs() < 1e-3, "{mean}");
    }

    #[test]
    fn growth_per_time_stays_while_a_unit_becomes_longer() {
        let growth = Growth::on(&grid());
        let mut block = [start(2, 0)];
        let log_rate = |block: &[ByRate<1>; 1]| -> f64 {
            let of = |rate: usize| f64::from(block[0][rate].as_flattened().iter().sum::<f32>());
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
        let mut block = start(0, 0);
        advance(&growth, &mut block, 1.0);
        let left: f32 = block[0].as_flattened().iter().sum();
        assert!((1.0 - left - 0.025 * 0.7).abs() < 1e-3, "{left}");
    }

    #[test]
    fn a_long_interval_reaches_at_least_as_far_as_many_short_ones() {
        let growth = Growth::on(&grid());
        let (mut long, mut short) = (start(3, 0), start(3, 0));
        advance(&growth, &mut long, 20.0);
        (0..20).for_each(|_| advance(&growth, &mut short, 1.0));
        let mean = |block: &ByRate<1>| -> f64 {
            let depths = grid();
            block.iter().flat_map(|row| row.iter().zip(&depths)).map(|([p], um)| f64::from(*p) * um).sum()
        };
        assert!(
            mean(&long) > mean(&short) && mean(&long) < 3.0 * mean(&short),
            "{} {}",
            mean(&long),
            mean(&short)
        );
    }
}
