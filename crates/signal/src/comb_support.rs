//! Support of a mesh comb by the lines of a spectrum, and comparison with other combs. Positions are in bins.

use smallvec::SmallVec;

use super::comb::{HARMONICS, SHAFT_RESOLVED_BINS};
use super::mesh_context::MeshContext;
use super::smeared_comb::SmearedLines;
use super::spectrum_lines::{REACH_BINS, REACH_FRACTION, SpectrumLines};

/// Score deducted at each position of a comb, in addition to what a position has on average.
const MISSING_LINE_PENALTY: f64 = 0.7;

/// Lines at this part of the multiples of a shaft's rate are the rule, as in a long record at a steady speed.
const DENSE_PART: f64 = 0.4;

/// A multiple of the mesh frequency is the true one if at least this many of its harmonics have a line, ...
const MIN_MULTIPLES: usize = 2;

/// ... or this many in a record that does not resolve the shafts.
const MIN_MULTIPLES_UNRESOLVED: usize = 3;

/// Search range of other combs, as fractions of the mesh frequency.
const OTHER_MESH_RANGE: [f64; 2] = [0.45, 2.3];

/// Combs within this fraction of the mesh frequency are the same.
const SAME_MESH_TOLERANCE: f64 = 0.004;
const SAME_SMEARED_MESH_TOLERANCE: f64 = 0.03;

/// Another comb fits better if its score exceeds this factor times the score plus this margin.
const MIN_GAIN_FACTOR: f64 = 1.25;
const MIN_GAIN: f64 = 2.0;

/// Fewest harmonics of a comb that stand out, where the spectrum holds as many.
const MIN_HARMONICS: u32 = 2;

/// Shaft rates are searched by their sidebands up to this order, around this many mesh harmonics.
const SIDEBANDS: u32 = 4;
const SIDEBAND_HARMONICS: u32 = 3;

/// Shaft rates are also searched by their own harmonics up to this one.
const SHAFT_HARMONICS: u32 = 8;

/// Search range of other shaft rates as fractions of the one given by teeth and mesh, and the tolerance
/// within which a rate counts as that one.
const OTHER_SHAFT_RANGE: [f64; 2] = [0.75, 1.33];
const SAME_SHAFT_TOLERANCE: f64 = 0.012;

/// Numbers of teeth that a mesh's sidebands are searched for.
const READABLE_TEETH: std::ops::RangeInclusive<u32> = 10..=150;

/// The fewest teeth are named whose score is at least this part of the best one.
const NEARLY_BEST: f64 = 0.85;

/// Another shaft rate needs this many lines, and a score higher by this margin.
const MIN_SHAFT_LINES: u32 = 7;
const MIN_SHAFT_GAIN: f64 = 8.0;

/// The support of a comb by the lines of a spectrum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Support {
    /// Number of harmonics whose line stands out.
    pub(super) found: u32,
    /// Number of harmonics searched.
    pub(super) sought: u32,
    /// The evidence against the comb, if any.
    pub(super) doubt: Option<CombDoubt>,
    /// What the lines fit instead, where they fit another mesh frequency better.
    pub(super) reading: Option<Reading>,
    /// Whether only smeared lines support the comb.
    pub(super) is_smeared: bool,
    /// Whether another mesh frequency that fits better has a line at half of its harmonics or more.
    pub(super) other_is_complete: bool,
}

impl Support {
    /// Whether at least half of the harmonics have a line.
    pub(super) fn is_complete(&self) -> bool {
        is_complete([self.found, self.sought])
    }
}

/// Returns how many harmonics of a comb have to stand out if this many are searched.
pub(super) fn min_harmonics(sought: u32) -> u32 {
    sought.clamp(1, MIN_HARMONICS)
}

fn is_complete([found, sought]: [u32; 2]) -> bool {
    2 * found >= sought
}

/// A reading of the lines: a mesh frequency in bins and, where its sidebands show it, the number of teeth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reading {
    pub(super) mesh: f64,
    pub(super) teeth: Option<u32>,
}

/// Evidence against a comb. Positions are in bins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum CombDoubt {
    /// Too few of its harmonics stand out.
    FewHarmonics,
    /// Another mesh frequency fits more of the lines.
    OtherMesh(f64),
    /// The sidebands are spaced by another shaft rate.
    OtherShaft(f64),
}

impl CombDoubt {
    /// Returns the mesh frequency that fits better, if this is the evidence.
    pub(super) fn other_mesh(self) -> Option<f64> {
        match self {
            Self::OtherMesh(other) => Some(other),
            Self::FewHarmonics | Self::OtherShaft(_) => None,
        }
    }
}

/// Computes the support of the comb with this mesh frequency by the narrow lines of `amplitude`.
pub(super) fn support(
    amplitude: &[f64],
    mesh: f64,
    context: &MeshContext,
    scratch: &mut Vec<f64>,
    log_ratios: &mut Vec<f64>,
) -> Support {
    let mut lines = SpectrumLines::of(up_to_comb(amplitude, mesh), scratch, log_ratios);
    lines.exclude_other_meshes(mesh, context);
    Comb::new(&lines, mesh, context, false).support()
}

/// Computes the support of a comb by narrow lines and by those that a fluctuating speed smears.
pub(super) fn smeared_support(
    amplitude: &[f64],
    mesh: f64,
    context: &MeshContext,
    scratch: &mut Vec<f64>,
    log_ratios: &mut Vec<f64>,
) -> Support {
    let amplitude = up_to_comb(amplitude, mesh);
    let mut lines = SpectrumLines::of(amplitude, scratch, log_ratios);
    lines.add(&SmearedLines::of(amplitude, scratch));
    lines.exclude_other_meshes(mesh, context);
    Comb::new(&lines, mesh, context, true).support()
}

fn up_to_comb(amplitude: &[f64], mesh: f64) -> &[f64] {
    let top = ((HARMONICS as f64 + 0.5) * mesh).min(amplitude.len() as f64 - 1.0) as usize;
    &amplitude[..=top]
}

/// Returns what the multiples of the rate of a shaft with this many teeth have on average, up to harmonic
/// `orders` of the mesh, if many of them have a line.
fn dense_level(lines: &SpectrumLines<'_>, mesh: f64, teeth: u32, orders: u32) -> Option<f64> {
    let shaft = mesh / f64::from(teeth);
    if shaft < SHAFT_RESOLVED_BINS {
        return None;
    }
    // As the shaft is resolved, there are at most as many multiples as bins.
    let multiples = teeth * orders;
    let all = (1..=multiples).map(|multiple| lines.at(f64::from(multiple) * shaft));
    let (found, sum) =
        all.fold((0_u32, 0.0), |(found, sum), line| (found + u32::from(line > 0.0), sum + line));
    (f64::from(found) >= DENSE_PART * f64::from(multiples)).then(|| sum / f64::from(multiples))
}

/// Returns whether a comb with this score fits better than one with the other.
fn is_better(score: f64, than: f64) -> bool {
    score > MIN_GAIN_FACTOR * than.max(0.0) + MIN_GAIN
}

/// A mesh comb with the lines among which it is judged.
struct Comb<'a> {
    lines: &'a SpectrumLines<'a>,
    /// Whether some of these are smeared.
    is_smeared: bool,
    /// The mesh frequency.
    mesh: f64,
    context: &'a MeshContext,
    /// Number of harmonics with a line, and of those that lie in the spectrum.
    found: u32,
    sought: u32,
    /// What a position has on average: of all bins or, if many of these have a line, of the multiples of a
    /// shaft's rate.
    typical: f64,
}

impl<'a> Comb<'a> {
    fn new(lines: &'a SpectrumLines<'a>, mesh: f64, context: &'a MeshContext, is_smeared: bool) -> Self {
        let [found, sought] = lines.harmonics(mesh);
        let typical = [context.teeth, context.mate_teeth]
            .into_iter()
            .filter(|teeth| *teeth > 0)
            .filter_map(|teeth| dense_level(lines, mesh, teeth, sought))
            .fold(lines.mean(), f64::max);
        Self { lines, is_smeared, mesh, context, found, sought, typical }
    }

    fn support(&self) -> Support {
        let Self { found, sought, is_smeared, .. } = *self;
        let slower_shaft = self.mesh / f64::from(self.context.teeth.max(self.context.mate_teeth).max(1));
        let doubt = if slower_shaft < SHAFT_RESOLVED_BINS {
            // There is no noise to read between the sidebands, but missing harmonics show.
            self.missing_multiple(MIN_MULTIPLES_UNRESOLVED)
                .map(|factor| CombDoubt::OtherMesh(factor * self.mesh))
        } else if let Some(other) = self.other_mesh() {
            Some(CombDoubt::OtherMesh(other))
        } else if found < min_harmonics(sought) {
            Some(CombDoubt::FewHarmonics)
        } else if is_smeared {
            // A smeared line covers its sidebands.
            None
        } else {
            self.other_shaft().map(CombDoubt::OtherShaft)
        };
        let other = doubt.and_then(CombDoubt::other_mesh);
        let reading = other.map(|other| self.reading(other));
        let other_is_complete = other.is_some_and(|other| is_complete(self.lines.harmonics(other)));
        Support { found, sought, doubt, reading, is_smeared, other_is_complete }
    }

    fn orders(&self) -> impl Iterator<Item = u32> + Clone {
        1..=self.sought
    }

    fn has_line(&self, order: u32) -> bool {
        self.lines.at(f64::from(order) * self.mesh) > 0.0
    }

    fn score_at(&self, position: f64) -> f64 {
        self.lines.at(position) - self.typical - MISSING_LINE_PENALTY
    }

    /// Returns the score of the comb with this mesh frequency over all lines.
    fn score(&self, mesh: f64) -> f64 {
        let positions = (1..).map(|order| f64::from(order) * mesh);
        positions
            .take_while(|position| *position < self.lines.bins() as f64 - 1.0)
            .map(|position| self.score_at(position))
            .sum()
    }

    /// Returns the mesh frequency that fits more of the lines than this one, if any.
    fn other_mesh(&self) -> Option<f64> {
        let mesh = self.mesh;
        // One step moves the highest harmonic by less than a line's reach.
        let step = (REACH_BINS / HARMONICS as f64).max(REACH_FRACTION * mesh);
        let steps = ((OTHER_MESH_RANGE[1] - OTHER_MESH_RANGE[0]) * mesh / step) as usize;
        let tolerance = if self.is_smeared { SAME_SMEARED_MESH_TOLERANCE } else { SAME_MESH_TOLERANCE };
        let best = (0..=steps)
            .map(|k| OTHER_MESH_RANGE[0] * mesh + k as f64 * step)
            .filter(|other| (other / mesh - 1.0).abs() > tolerance)
            .map(|other| (other, self.score(other)))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let better = best.filter(|(_, score)| is_better(*score, self.score(mesh)));
        better.map(|(other, _)| other).or_else(|| {
            self.missing_multiple(MIN_MULTIPLES)
                .map(|factor| factor * mesh)
                .or_else(|| self.has_lines_between().then_some(0.5 * mesh))
        })
    }

    /// Returns 2 or 3 if only every second or third harmonic has a line, and at least `min_multiples` have
    /// one: the true mesh frequency is that multiple.
    fn missing_multiple(&self, min_multiples: usize) -> Option<f64> {
        [2, 3].into_iter().find_map(|factor| {
            let found = self.orders().filter(|order| self.has_line(*order));
            let multiples = found.clone().filter(|order| order % factor == 0).count();
            let others = found.count() - multiples;
            (multiples >= min_multiples && 3 * others < multiples).then_some(f64::from(factor))
        })
    }

    /// Returns whether lines as strong as the harmonics lie half-way between them.
    fn has_lines_between(&self) -> bool {
        let above_typical = |shift: f64| {
            let positions = self.orders().map(move |order| (f64::from(order) - shift) * self.mesh);
            let lines = positions.filter(|position| self.score_at(*position) > 0.0);
            lines.map(|position| self.lines.at(position) - self.typical)
        };
        let (between, on) = (above_typical(0.5), above_typical(0.0));
        between.clone().count() >= min_harmonics(self.sought) as usize
            && between.sum::<f64>() > 0.5 * on.sum::<f64>()
    }

    /// Returns how many of a shaft's harmonics and sidebands around a mesh have a line, and their score.
    fn shaft_lines(&self, mesh: f64, shaft: f64) -> (u32, f64) {
        let sides = |harmonic: u32| {
            let orders = (1..=SIDEBANDS).flat_map(|order| [-1.0, 1.0].map(|side| side * f64::from(order)));
            orders.map(move |order| f64::from(harmonic) * mesh + order * shaft)
        };
        let harmonics = (1..=SHAFT_HARMONICS).map(|order| f64::from(order) * shaft);
        let positions = harmonics.chain((1..=SIDEBAND_HARMONICS).flat_map(sides));
        positions.fold((0, 0.0), |(count, score), position| {
            (count + u32::from(self.lines.at(position) > 0.0), score + self.score_at(position))
        })
    }

    /// Returns the reading of a mesh frequency that fits the lines: a half or a third of it where that has
    /// lines too, and the teeth whose shaft spaces its sidebands best.
    fn reading(&self, other: f64) -> Reading {
        let score = self.score(other);
        let lower = [0.5, 1.0 / 3.0].into_iter().map(|part| part * other);
        let better = lower
            .map(|mesh| (mesh, self.score(mesh)))
            .filter(|(_, lower)| is_better(*lower, score))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let mesh = better.map_or(other, |(mesh, _)| mesh);
        let spaced: Vec<(u32, f64)> = READABLE_TEETH
            .map(|teeth| (teeth, self.shaft_lines(mesh, mesh / f64::from(teeth))))
            .filter(|(_, (count, score))| *count >= MIN_SHAFT_LINES && *score > MIN_SHAFT_GAIN)
            .map(|(teeth, (_, score))| (teeth, score))
            .collect();
        // A half of the true shaft rate has the same lines.
        let best = spaced.iter().map(|(_, score)| *score).fold(0.0, f64::max);
        let teeth = spaced.iter().find(|(_, score)| *score >= NEARLY_BEST * best).map(|(teeth, _)| *teeth);
        Reading { mesh, teeth }
    }

    /// Returns the shaft rate that spaces the sidebands, if it is not the one given by teeth and mesh.
    fn other_shaft(&self) -> Option<f64> {
        let (mesh, context) = (self.mesh, self.context);
        let shaft = mesh / f64::from(context.teeth.max(1));
        let mate = (context.mate_teeth > 0).then(|| mesh / f64::from(context.mate_teeth));
        let others = context.others.shaft_orders().map(|order| order * shaft);
        let known: SmallVec<[f64; 8]> = [shaft].into_iter().chain(mate).chain(others).collect();
        let lines_of = |shaft: f64| self.shaft_lines(mesh, shaft);
        let own = known.iter().map(|shaft| lines_of(*shaft).1).fold(f64::NEG_INFINITY, f64::max);
        let step = REACH_BINS / f64::from(SIDEBANDS);
        let steps = ((OTHER_SHAFT_RANGE[1] - OTHER_SHAFT_RANGE[0]) * shaft / step) as usize;
        let (other, (count, score)) = (0..=steps)
            .map(|k| OTHER_SHAFT_RANGE[0] * shaft + k as f64 * step)
            .filter(|other| known.iter().all(|shaft| (other / shaft - 1.0).abs() > SAME_SHAFT_TOLERANCE))
            .map(|other| (other, lines_of(other)))
            .max_by(|a, b| a.1.1.total_cmp(&b.1.1))?;
        let is_other = count >= MIN_SHAFT_LINES && score > own + MIN_SHAFT_GAIN;
        is_other.then_some(other)
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
        MeshContext::new([TEETH, 26], 0.0, 0.0)
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
    fn a_comb_with_its_lines_has_no_doubt() {
        let shaft = MESH / f64::from(TEETH);
        for positions in [
            comb(MESH).collect::<Vec<_>>(),
            comb(MESH).skip(1).step_by(2).chain([MESH, 3.0 * MESH]).collect(),
            comb(MESH).take(4).chain(shaft_lines(shaft)).collect(),
        ] {
            let support = support_of(MESH, positions.iter().copied(), &context());
            assert_eq!((support.doubt, support.sought), (None, 16), "{positions:?}");
            assert!(support.found >= 4, "{support:?}");
        }
    }

    #[test]
    fn lines_at_all_multiples_of_the_shaft_rate_are_no_other_mesh() {
        let shaft = MESH / f64::from(TEETH);
        let multiples = (1..=16 * TEETH).map(|multiple| f64::from(multiple) * shaft);
        let support = support_of(MESH, multiples, &context());
        assert_eq!((support.found, support.doubt), (16, None));
    }

    #[test]
    fn half_of_the_mesh_frequency_is_in_doubt_in_a_short_record_too() {
        // The slower shaft is at 6.9 bins.
        let context = MeshContext::new([61, 70], 0.0, 0.0);
        let support = support_of(MESH, comb(2.0 * MESH), &context);
        assert_eq!(support.doubt, Some(CombDoubt::OtherMesh(2.0 * MESH)));
        assert_eq!(support_of(MESH, comb(MESH), &context).doubt, None);
    }

    #[test]
    fn a_single_line_is_not_a_comb() {
        let support = support_of(MESH, [MESH], &context());
        assert_eq!((support.found, support.doubt), (1, Some(CombDoubt::FewHarmonics)));
        assert_eq!(support_of(MESH, [], &context()).doubt, Some(CombDoubt::FewHarmonics));
    }

    /// At 3.2 kHz and 10 kHz, for example, the second harmonic lies above half the sampling rate.
    #[test]
    fn the_only_harmonic_below_half_the_rate_is_a_comb() {
        let mesh = 0.32 * LENGTH as f64;
        let support = support_of(mesh, [mesh], &context());
        assert_eq!((support.found, support.sought, support.doubt), (1, 1, None));
        assert_eq!(support_of(mesh, [], &context()).doubt, Some(CombDoubt::FewHarmonics));
        // An even harmonic of another mesh is no such comb.
        for part in [2.0, 4.0, 6.0, 8.0] {
            let lines = comb(mesh / part).take_while(|position| *position < 0.48 * LENGTH as f64);
            let doubt = support_of(mesh, lines, &context()).doubt;
            assert!(matches!(doubt, Some(CombDoubt::OtherMesh(_))), "{part}: {doubt:?}");
        }
    }

    /// 4 × 480.3 is a harmonic of either, and so on; the truth lies within a bin.
    #[test]
    fn doubt_names_the_better_mesh_frequency() {
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
    fn a_reading_names_the_fundamental_and_its_teeth() {
        // Harmonics of 480.3 bins with the sidebands of 24 teeth, taken for 2.5 times that frequency.
        let positions = || comb(MESH).chain((11..=25).map(|order| f64::from(order) * MESH));
        let with_shaft = positions().chain(shaft_lines(MESH / 24.0));
        for (lines, teeth) in [(positions().collect::<Vec<_>>(), None), (with_shaft.collect(), Some(24))] {
            let support = support_of(2.5 * MESH, lines, &context());
            assert!(matches!(support.doubt, Some(CombDoubt::OtherMesh(_))), "{support:?}");
            let reading = support.reading.unwrap();
            assert!((reading.mesh / MESH - 1.0).abs() < 2e-3 && reading.teeth == teeth, "{reading:?}");
        }
    }

    #[test]
    fn doubt_names_the_better_shaft_rate() {
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
    fn zeros_do_not_panic() {
        for amplitude in [vec![0.0; 2], vec![0.0; 4000], vec![1.0; 30]] {
            let support = support(&amplitude, 10.0, &context(), &mut Vec::new(), &mut Vec::new());
            assert_eq!(support.found, 0);
        }
    }
}
