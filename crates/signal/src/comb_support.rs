//! How well the lines of a spectrum support a mesh comb, and whether they support another one better.
//! Positions are in bins.

use super::line::{MEDIAN_OF_NOISE, fits, noise_amplitude};
use super::mesh_comb::SHAFT_RESOLVED_BINS;
use super::speed::MeshContext;
use super::sums::mean_of;

/// Harmonics that are looked at.
const ORDERS: usize = 10;

/// A line counts where it stands this far above the noise beside it: noise alone does so in one bin of e¹⁶ =
/// 9 million.
const STANDS_OUT: f64 = 4.0;

/// A line's ratio to the noise counts up to this one: one strong line is no comb.
const MAX_OF_ONE: f64 = 32.0;

/// A line counts for a harmonic within this part of its position, and this many bins.
const REACH_FRACTION: f64 = 7e-4;
const REACH_BINS: f64 = 1.0;

/// The noise is the median over so many bins, and as many around them.
const NOISE_BINS: usize = 128;

/// The least noise, as a part of the highest line: below it stand the skirts of lines in a record that has
/// hardly any noise.
const NOISE_FLOOR: f64 = 1e-3;

/// What a harmonic without a line takes off, beside what a position anywhere has by chance.
const MISSING: f64 = 0.7;

/// Other combs are looked for from here to there, in parts of the mesh frequency.
const OTHERS: [f64; 2] = [0.45, 2.3];

/// Combs within this part of the mesh frequency are the same.
const SAME_COMB: f64 = 0.004;

/// Another comb fits better where its sum is larger by this factor and this much more.
const BETTER: f64 = 1.25;
const BETTER_BY: f64 = 2.0;

/// Fewest harmonics of a comb.
const MIN_HARMONICS: u32 = 2;

/// Shaft rates around the mesh harmonics are looked for up to this order of sideband, around so many
/// harmonics.
const SIDEBANDS: u32 = 4;
const SIDEBAND_HARMONICS: u32 = 3;

/// And the harmonics of the shaft rate itself up to this one.
const SHAFT_LINES: u32 = 8;

/// Shaft rates from here to there, in parts of the one that teeth and mesh give, but not within a part of it.
const OTHER_SHAFTS: [f64; 2] = [0.75, 1.33];
const SAME_SHAFT: f64 = 0.012;

/// So many lines have to stand at another shaft rate, and its sum has to be so much larger, before it is one.
const MIN_SHAFT_LINES: u32 = 7;
const BETTER_SHAFT_BY: f64 = 8.0;

/// What the lines say of a comb.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Support {
    /// Harmonics whose line stands out.
    pub(super) found: u32,
    /// Harmonics that were looked for.
    pub(super) sought: u32,
    /// What speaks against the comb.
    pub(super) doubt: Option<CombDoubt>,
}

/// What speaks against a comb; positions in bins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum CombDoubt {
    /// Too few of its harmonics stand out.
    FewHarmonics,
    /// Another mesh frequency has more of the lines.
    OtherMesh(f64),
    /// The sidebands stand at another shaft rate.
    OtherShaft(f64),
}

/// The lines of a spectrum up to a frequency: for each bin the logarithm of how far a line within its reach
/// stands above the noise, 0 where there is none.
struct Lines<'a> {
    says: &'a mut [f64],
    /// What a position has on the mean, and what a missing line takes off.
    chance: f64,
}

/// What the lines of `amplitude` say of the comb with this mesh frequency.
pub(super) fn support(
    amplitude: &[f64],
    mesh: f64,
    context: &MeshContext,
    scratch: &mut Vec<f64>,
    says: &mut Vec<f64>,
) -> Support {
    let sought = (1..=ORDERS).take_while(|order| fits(*order as f64 * mesh, amplitude.len())).count() as u32;
    let top = ((ORDERS as f64 + 0.5) * mesh).min(amplitude.len() as f64 - 1.0) as usize;
    let mut lines = Lines::of(&amplitude[..=top], scratch, says);
    lines.without(mesh, context);
    let found = (1..=sought).filter(|order| lines.at(f64::from(*order) * mesh) > 0.0).count() as u32;
    let slower_shaft = mesh / f64::from(context.teeth.max(context.mate_teeth).max(1));
    let doubt = if slower_shaft < SHAFT_RESOLVED_BINS {
        // No noise is seen between the sidebands.
        None
    } else if let Some(other) = lines.other_mesh(mesh, sought) {
        Some(CombDoubt::OtherMesh(other))
    } else if found < MIN_HARMONICS {
        Some(CombDoubt::FewHarmonics)
    } else {
        lines.other_shaft(mesh, context).map(CombDoubt::OtherShaft)
    };
    Support { found, sought, doubt }
}

fn highest(amplitude: &[f64]) -> f64 {
    let (blocks, rest) = amplitude.as_chunks::<8>();
    let larger = |a: f64, b: f64| if b > a { b } else { a };
    let mut parts = [0.0; 8];
    for block in blocks {
        parts.iter_mut().zip(block).for_each(|(part, value)| *part = larger(*part, *value));
    }
    parts.into_iter().chain(rest.iter().copied()).fold(0.0, larger)
}

/// Whether even this highest bin does not stand out of the noise that the median of the bins `around` gives.
/// Most stretches have no line, and to count the bins below a level takes a tenth of finding their median.
fn nothing_stands_out(highest: f64, around: &[f64], least: f64) -> bool {
    if highest < STANDS_OUT * least {
        return true;
    }
    // The median is above this level where no more than half of the bins are not.
    let level = highest / STANDS_OUT * MEDIAN_OF_NOISE * (1.0 + 1e-9);
    let below = around.iter().map(|a| u32::from(*a <= level)).sum::<u32>();
    below as usize <= around.len() / 2
}

impl<'a> Lines<'a> {
    fn of(amplitude: &[f64], scratch: &mut Vec<f64>, says: &'a mut Vec<f64>) -> Self {
        let length = amplitude.len();
        says.clear();
        says.resize(length, 0.0);
        let least = NOISE_FLOOR * highest(amplitude);
        for start in (0..length).step_by(NOISE_BINS) {
            let end = (start + NOISE_BINS).min(length);
            let around = &amplitude[start.saturating_sub(NOISE_BINS / 2)..(end + NOISE_BINS / 2).min(length)];
            if nothing_stands_out(highest(&amplitude[start..end]), around, least) {
                continue;
            }
            scratch.clear();
            scratch.extend_from_slice(around);
            let Some(noise) =
                noise_amplitude(scratch).map(|noise| noise.max(least)).filter(|noise| *noise > 0.0)
            else {
                continue;
            };
            for bin in start.max(1)..end.min(length - 1) {
                let here = amplitude[bin];
                if here < STANDS_OUT * noise || here < amplitude[bin - 1] || here < amplitude[bin + 1] {
                    continue;
                }
                let value = (here / noise).min(MAX_OF_ONE).ln();
                let reach = (REACH_BINS + REACH_FRACTION * bin as f64) as usize;
                for says in &mut says[bin.saturating_sub(reach)..=(bin + reach).min(length - 1)] {
                    *says = says.max(value);
                }
            }
        }
        let chance = MISSING + mean_of(says, |says| *says);
        Self { says, chance }
    }

    /// Leaves out the lines of the other meshes that are described.
    fn without(&mut self, mesh: f64, context: &MeshContext) {
        if context.others.is_empty() {
            return;
        }
        let shaft = mesh / f64::from(context.teeth.max(1));
        for (bin, says) in self.says.iter_mut().enumerate().filter(|(_, says)| **says > 0.0) {
            let reach = 2.0 * (REACH_BINS + REACH_FRACTION * bin as f64);
            if context.others.lie_at(bin as f64 / shaft, reach / shaft) {
                *says = 0.0;
            }
        }
    }

    fn at(&self, position: f64) -> f64 {
        self.says.get((position + 0.5) as usize).copied().unwrap_or(0.0)
    }

    /// What all lines say for a comb.
    fn sum(&self, mesh: f64) -> f64 {
        let positions = (1..).map(|order| f64::from(order) * mesh);
        positions
            .take_while(|position| *position < self.says.len() as f64 - 1.0)
            .map(|position| self.at(position) - self.chance)
            .sum()
    }

    /// The mesh frequency that has more of the lines than this one.
    fn other_mesh(&self, mesh: f64, sought: u32) -> Option<f64> {
        // A step moves the highest harmonic by less than a line's reach.
        let step = (REACH_BINS / ORDERS as f64).max(REACH_FRACTION * mesh);
        let steps = ((OTHERS[1] - OTHERS[0]) * mesh / step) as usize;
        let best = (0..=steps)
            .map(|k| OTHERS[0] * mesh + k as f64 * step)
            .filter(|other| (other / mesh - 1.0).abs() > SAME_COMB)
            .map(|other| (other, self.sum(other)))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let better = best.filter(|(_, sum)| *sum > BETTER * self.sum(mesh).max(0.0) + BETTER_BY);
        better.map(|(other, _)| other).or_else(|| {
            self.multiple(mesh, sought)
                .map(|factor| factor * mesh)
                .or_else(|| self.stands_between(mesh, sought).then_some(0.5 * mesh))
        })
    }

    /// Where only each second or third harmonic has a line, the mesh is that multiple.
    fn multiple(&self, mesh: f64, sought: u32) -> Option<f64> {
        let has_line = |order: &u32| self.at(f64::from(*order) * mesh) > 0.0;
        [2, 3].into_iter().find_map(|factor| {
            let (of, beside): (Vec<u32>, Vec<u32>) =
                (1..=sought).filter(has_line).partition(|order| order % factor == 0);
            (of.len() >= 2 && 3 * beside.len() < of.len()).then_some(f64::from(factor))
        })
    }

    /// Whether lines as strong as the harmonics stand half-way between them.
    fn stands_between(&self, mesh: f64, sought: u32) -> bool {
        let says = |shift: f64| -> Vec<f64> {
            let positions = (1..=sought).map(|order| (f64::from(order) - shift) * mesh);
            positions.map(|position| self.at(position)).filter(|line| *line > 0.0).collect()
        };
        let (between, on) = (says(0.5), says(0.0));
        between.len() >= 2 && between.iter().sum::<f64>() > 0.5 * on.iter().sum::<f64>()
    }

    /// The shaft rate at which the sidebands stand, where that is not the one that teeth and mesh give.
    fn other_shaft(&self, mesh: f64, context: &MeshContext) -> Option<f64> {
        let shaft = mesh / f64::from(context.teeth.max(1));
        let mate = (context.mate_teeth > 0).then(|| mesh / f64::from(context.mate_teeth));
        let others = context.others.shaft_orders().map(|order| order * shaft);
        let known: Vec<f64> = [shaft].into_iter().chain(mate).chain(others).collect();
        let lines_of = |shaft: f64| {
            let mut sum = (0, 0.0);
            for order in 1..=SHAFT_LINES {
                let line = self.at(f64::from(order) * shaft);
                sum.0 += u32::from(line > 0.0);
                sum.1 += line - self.chance;
            }
            for harmonic in 1..=SIDEBAND_HARMONICS {
                for order in 1..=SIDEBANDS {
                    for side in [-1.0, 1.0] {
                        let line = self.at(f64::from(harmonic) * mesh + side * f64::from(order) * shaft);
                        sum.0 += u32::from(line > 0.0);
                        sum.1 += line - self.chance;
                    }
                }
            }
            sum
        };
        let own = known.iter().map(|shaft| lines_of(*shaft).1).fold(f64::NEG_INFINITY, f64::max);
        let step = REACH_BINS / f64::from(SIDEBANDS);
        let steps = ((OTHER_SHAFTS[1] - OTHER_SHAFTS[0]) * shaft / step) as usize;
        let (other, (count, sum)) = (0..=steps)
            .map(|k| OTHER_SHAFTS[0] * shaft + k as f64 * step)
            .filter(|other| known.iter().all(|shaft| (other / shaft - 1.0).abs() > SAME_SHAFT))
            .map(|other| (other, lines_of(other)))
            .max_by(|a, b| a.1.1.total_cmp(&b.1.1))?;
        let stands = count >= MIN_SHAFT_LINES && sum > own + BETTER_SHAFT_BY;
        stands.then_some(other)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::super::other_meshes::{OtherMesh, OtherMeshes};
    use super::super::spectrum::hann_amplitude;
    use super::super::transform::Transforms;
    use super::*;

    const LENGTH: usize = 20_000;
    const TEETH: u32 = 24;
    const MESH: f64 = 480.3;

    fn context() -> MeshContext {
        MeshContext { teeth: TEETH, mate_teeth: 26, others: OtherMeshes::NONE, ..MeshContext::unknown() }
    }

    /// The support of a mesh in white noise with lines at these positions in bins, each as strong as the
    /// noise.
    fn support_of(mesh: f64, positions: impl IntoIterator<Item = f64>, context: &MeshContext) -> Support {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let mut samples: Vec<f64> = (0..LENGTH).map(|_| StandardNormal.sample(&mut random)).collect();
        for position in positions {
            for (i, x) in samples.iter_mut().enumerate() {
                *x += (TAU * position * i as f64 / LENGTH as f64 + position).sin();
            }
        }
        let (mut bins, mut amplitude) = (Vec::new(), Vec::new());
        Transforms::default().forward(&mut samples, &mut bins);
        hann_amplitude(&bins, LENGTH, &mut amplitude);
        support(&amplitude, mesh, context, &mut Vec::new(), &mut Vec::new())
    }

    fn comb(mesh: f64) -> impl Iterator<Item = f64> + Clone {
        (1..=10).map(move |order| f64::from(order) * mesh)
    }

    /// Shaft harmonics and sidebands of the first three mesh harmonics.
    fn shaft_lines(shaft: f64) -> Vec<f64> {
        let beside = (1..=3).flat_map(move |k| [-1.0, 1.0].map(|side| side * f64::from(k) * shaft));
        let sidebands = (1..=3).flat_map(|h| beside.clone().map(move |beside| f64::from(h) * MESH + beside));
        (1..=4).map(|k| f64::from(k) * shaft).chain(sidebands).collect()
    }

    #[test]
    fn a_comb_whose_lines_are_there_is_not_doubted() {
        let shaft = MESH / f64::from(TEETH);
        for positions in [
            comb(MESH).collect::<Vec<_>>(),
            comb(MESH).skip(1).step_by(2).chain([MESH, 3.0 * MESH]).collect(),
            comb(MESH).take(4).chain(shaft_lines(shaft)).collect(),
        ] {
            let support = support_of(MESH, positions.iter().copied(), &context());
            assert_eq!((support.doubt, support.sought), (None, 10), "{positions:?}");
            assert!(support.found >= 4, "{support:?}");
        }
    }

    #[test]
    fn one_line_is_no_comb() {
        let support = support_of(MESH, [MESH], &context());
        assert_eq!((support.found, support.doubt), (1, Some(CombDoubt::FewHarmonics)));
        assert_eq!(support_of(MESH, [], &context()).doubt, Some(CombDoubt::FewHarmonics));
    }

    /// 4 × 480.3 is a harmonic of either, and so on; the truth lies within a bin.
    #[test]
    fn the_comb_that_has_the_lines_is_named() {
        for part in [4.0 / 3.0, 0.75, 2.0, 0.5, 0.83] {
            let truth = part * MESH;
            match support_of(MESH, comb(truth), &context()).doubt {
                Some(CombDoubt::OtherMesh(other)) => {
                    assert!((other - truth).abs() < 1.5, "{part}: {other} against {truth}")
                }
                doubt => panic!("{part}: {doubt:?}"),
            }
        }
    }

    #[test]
    fn the_shaft_rate_that_has_the_lines_is_named() {
        let truth = MESH / 25.0;
        let positions = || comb(MESH).take(4).chain(shaft_lines(truth));
        match support_of(MESH, positions(), &context()).doubt {
            Some(CombDoubt::OtherShaft(other)) => {
                assert!((other - truth).abs() < 0.5, "{other} against {truth}")
            }
            doubt => panic!("{doubt:?}"),
        }
        // The shafts of the mate and of other meshes are no reason for a doubt.
        let mate = MeshContext { mate_teeth: 25, ..context() };
        assert_eq!(support_of(MESH, positions(), &mate).doubt, None);
        let others =
            OtherMeshes::of([OtherMesh { mesh_orders: 31.0, shaft_orders: [f64::from(TEETH) / 25.0, 0.4] }]);
        assert_eq!(support_of(MESH, positions(), &MeshContext { others, ..context() }).doubt, None);
    }

    #[test]
    fn nothing_at_all_is_no_panic() {
        for amplitude in [vec![0.0; 2], vec![0.0; 4000], vec![1.0; 30]] {
            let support = support(&amplitude, 10.0, &context(), &mut Vec::new(), &mut Vec::new());
            assert_eq!(support.found, 0);
        }
    }
}
