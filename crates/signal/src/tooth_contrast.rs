//! Differences between the teeth of one shaft: the part of a turn that does not belong to the mesh harmonics,
//! and whether one tooth has more of it than the others.
//!
//! Wear affects all teeth alike, so it changes the mesh harmonics and, with the gears' own errors, the
//! sidebands next to them. A single different tooth (a crack, a chip) acts once per turn over one tooth's
//! angle: it causes many weak sidebands far from the harmonics.

use flankwatch_fourier::Complex;
use pulp::{Arch, Simd, WithSimd};
use smallvec::SmallVec;
use smol_str::format_smolstr;

use super::angle_record::AngleRecord;
use super::features::Features;
use super::mesh_context::MeshContext;
use super::record_spectrum::{RecordSpectrum, SinglePrecision};
use super::sums::sum_of;
use super::transform::Transforms;

/// Shaft orders excluded on each side of a mesh harmonic: errors of the whole gear modulate the mesh there.
const EXCLUDED_ORDERS: usize = 3;

/// Fewest teeth: with fewer, hardly any order remains between the harmonics.
const MIN_TEETH: usize = 10;

/// Below this fraction of the average's standard deviation, a signal is rounding.
const ROUNDING: f64 = 1e-7;

/// Numbers of turns averaged. The residual noise of an average depends on this number, so records of
/// different lengths are compared by averages of equal size.
const GROUPS: [usize; 4] = [128, 32, 8, 2];

/// This many of the largest groups that a record fills are used.
const MAX_GROUPS: usize = 3;

/// Inserts three ratios of the part of a turn between the harmonics of this mesh and of others, for averages
/// of 128, 32, 8 or 2 turns. They do not depend on the sensor's gain and are natural logarithms of
/// amplitudes. Nothing is inserted for a gear with fewer than 10 teeth, or if order `teeth` + 1 lies above
/// half the samples of a turn.
pub(super) fn insert_tooth_checks(
    angle_record: &AngleRecord,
    mesh: &MeshContext,
    harmonics: usize,
    work: &mut RecordSpectrum,
    features: &mut Features,
) {
    let (teeth, per_turn) = (mesh.teeth as usize, angle_record.samples_per_turn);
    if teeth < MIN_TEETH || 2 * (teeth + 1) >= per_turn {
        return;
    }
    let RecordSpectrum { transforms: double, single: SinglePrecision { transforms, .. }, .. } = work;
    let highest = (harmonics * teeth + teeth / 2).min((per_turn - 1) / 2);
    let mut mask = transforms.buffer();
    mask.extend((0..=per_turn / 2).map(|order| {
        let beside = (order % teeth).min(teeth - order % teeth);
        let is_excluded =
            beside <= EXCLUDED_ORDERS || order > highest || mesh.others.contains(order as f64, 0.0);
        f32::from(u8::from(!is_excluded))
    }));
    let filled = GROUPS.into_iter().filter(|group| *group <= angle_record.turns).take(MAX_GROUPS);
    let level = |group| {
        let bins = [transforms.complex_buffer(), transforms.complex_buffer()];
        Contrast::of(group, teeth, bins, double.buffer())
    };
    let mut levels: SmallVec<[Contrast; MAX_GROUPS]> = filled.map(level).collect();
    // The smallest group first: its averages sum to those of the larger ones.
    levels.reverse();
    let smallest = levels.first().map_or(usize::MAX, |level| level.group);
    let [mut even, mut odd] = [transforms.buffer(), transforms.buffer()];
    for first in (0..angle_record.turns / smallest).map(|index| index * smallest) {
        angle_record.sum_into(first..first + smallest, [&mut even, &mut odd]);
        // The difference between even and odd turns has the noise of the average without the repeating part.
        for (even, odd) in even.iter_mut().zip(&mut odd) {
            (*even, *odd) = (*even + *odd, *even - *odd);
        }
        levels[0].turns += smallest;
        for (signal, bins) in [&mut even, &mut odd].into_iter().zip(&mut levels[0].bins) {
            transforms.forward(signal, bins);
        }
        for index in 0..levels.len() {
            let (below, above) = levels.split_at_mut(index + 1);
            let level = &mut below[index];
            if level.turns < level.group {
                break;
            }
            if let Some(above) = above.first_mut() {
                above.add(level);
            }
            level.add_average(&mask, &mut even, transforms);
        }
    }
    let mut by_pitch = double.buffer();
    for level in levels {
        level.insert(features, &mut by_pitch);
        let Contrast { bins, squares, .. } = level;
        bins.into_iter().for_each(|bins| transforms.recycle_complex(bins));
        double.recycle(squares);
    }
    double.recycle(by_pitch);
    for buffer in [mask, even, odd] {
        transforms.recycle(buffer);
    }
}

/// The part between the mesh harmonics in several averages of the same number of turns.
struct Contrast {
    /// Turns per average, and turns summed so far for the current one.
    group: usize,
    turns: usize,
    teeth: usize,
    /// Transforms of the sum of all turns, and of the difference between even and odd ones.
    bins: [Vec<Complex<f32>>; 2],
    averages: f64,
    /// Sums over the averages: mean square between the harmonics, mean square of the noise in it, and fourth
    /// moment.
    repeated: f64,
    noise: f64,
    fourth: f64,
    /// Level below which a mean square is rounding.
    floor: f64,
    /// Sum of the averages' squares, by angle.
    squares: Vec<f64>,
}

impl Contrast {
    fn of(group: usize, teeth: usize, bins: [Vec<Complex<f32>>; 2], squares: Vec<f64>) -> Self {
        Self {
            group,
            turns: 0,
            teeth,
            bins,
            averages: 0.0,
            repeated: 0.0,
            noise: 0.0,
            fourth: 0.0,
            floor: 0.0,
            squares,
        }
    }

    /// Adds the turns of a smaller group.
    fn add(&mut self, part: &Self) {
        for (bins, others) in self.bins.iter_mut().zip(&part.bins) {
            if self.turns == 0 {
                bins.clear();
                bins.extend_from_slice(others);
            } else {
                bins.iter_mut().zip(others).for_each(|(bin, other)| *bin += other);
            }
        }
        self.turns += part.turns;
    }

    /// Completes the average of a whole group and leaves the part between the harmonics in `signal`. By
    /// Parseval's theorem mean squares follow from the transforms.
    fn add_average(&mut self, mask: &[f32], signal: &mut [f32], transforms: &mut Transforms<f32>) {
        let scale = 1.0 / (self.group * signal.len()) as f64;
        let [bins, alternating] = &mut self.bins;
        // Each bin except the end ones also represents its mirror image.
        let ends = [bins.first(), bins.last()].into_iter().flatten().map(norm_sqr).sum::<f64>();
        let arch = Arch::new();
        let [whole, repeated] = arch.dispatch(Masking { bins, mask, scale });
        let [_, noise] = arch.dispatch(Masking { bins: alternating, mask, scale });
        self.floor = self.floor.max(ROUNDING * ROUNDING * scale * scale * (2.0 * whole - ends));
        self.averages += 1.0;
        self.repeated += 2.0 * repeated;
        self.noise += 2.0 * noise;
        transforms.inverse(bins, signal);
        self.squares.resize(signal.len(), 0.0);
        self.fourth += arch.dispatch(Squares { signal, squares: &mut self.squares }) / signal.len() as f64;
        self.turns = 0;
    }

    fn insert(&self, features: &mut Features, by_pitch: &mut Vec<f64>) {
        let scale = 1.0 / self.averages;
        let [repeated, noise, fourth] = [self.repeated, self.noise, self.fourth].map(|sum| sum * scale);
        let is_finite = [repeated, noise, fourth].iter().all(|sum| sum.is_finite());
        if repeated > self.floor && is_finite {
            self.insert_check([repeated, noise, fourth], features, by_pitch);
        }
    }

    fn insert_check(
        &self,
        [repeated, noise, fourth]: [f64; 3],
        features: &mut Features,
        by_pitch: &mut Vec<f64>,
    ) {
        let turns = self.group;
        let mut insert_check = |name: &str, squared: f64| {
            features.checks.insert(format_smolstr!("{name}_{turns}"), 0.5 * squared.ln())
        };
        insert_check("ln_tooth_repeated", repeated / noise.max(self.floor));
        insert_check("ln_tooth_kurtosis", fourth / (repeated * repeated));
        pitch_energies(&self.squares, self.teeth, by_pitch);
        let worst = by_pitch.iter().copied().fold(0.0, f64::max);
        let middle = by_pitch.len() / 2;
        let (_, median, _) = by_pitch.select_nth_unstable_by(middle, f64::total_cmp);
        insert_check("ln_tooth_worst", worst / median.max(self.floor * self.averages));
    }
}

/// Multiplies bins by `scale` and by a mask of zeros and ones. Returns the sums of their squares before and
/// after that.
struct Masking<'a> {
    bins: &'a mut [Complex<f32>],
    mask: &'a [f32],
    scale: f64,
}

impl WithSimd for Masking<'_> {
    type Output = [f64; 2];

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> [f64; 2] {
        let before = sum_of(self.bins, norm_sqr);
        let scale = self.scale as f32;
        for (bin, mask) in self.bins.iter_mut().zip(self.mask) {
            *bin *= mask * scale;
        }
        [before, sum_of(self.bins, norm_sqr)]
    }
}

/// Returns the square of a bin's magnitude.
#[inline(always)]
fn norm_sqr(bin: &Complex<f32>) -> f64 {
    Complex::new(f64::from(bin.re), f64::from(bin.im)).norm_sqr()
}

/// Adds the squares of a signal and returns the sum of their squares.
struct Squares<'a> {
    signal: &'a [f32],
    squares: &'a mut [f64],
}

impl WithSimd for Squares<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        for (square, &x) in self.squares.iter_mut().zip(self.signal) {
            *square += f64::from(x) * f64::from(x);
        }
        sum_of(self.signal, |&x| f64::from(x).powi(4))
    }
}

/// Writes the mean over one tooth's pitch around each angle of the turn.
fn pitch_energies(squares: &[f64], teeth: usize, energies: &mut Vec<f64>) {
    let pitch = (squares.len() / teeth).max(1);
    let mut sum: f64 = squares[..pitch].iter().sum();
    let entering = squares[pitch..].iter().chain(&squares[..pitch]);
    let energy = |(entering, leaving): (&f64, &f64)| {
        let energy = sum.max(0.0) / pitch as f64;
        sum += entering - leaving;
        energy
    };
    energies.clear();
    energies.extend(entering.zip(squares).map(energy));
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::super::{AngleSource, OtherMesh, OtherMeshes};
    use super::*;

    const TEETH: u32 = 24;
    const PER_TURN: usize = 1200;
    const TURNS: usize = 16;

    /// The second stage of a gearbox, seen from the first.
    const OTHER_ORDERS: f64 = 19.0 * 24.0 / 26.0;

    fn of_teeth(teeth: u32) -> MeshContext {
        MeshContext { teeth, ..MeshContext::unknown() }
    }

    /// Mesh harmonics of amplitude `mesh`/h, modulated once per turn, and white noise; on one tooth of each
    /// turn a burst of amplitude `burst`.
    fn checks(mesh: f64, burst: f64) -> Features {
        checks_beside(mesh, burst, 0.0, OtherMeshes::NONE)
    }

    /// The same with a line of another mesh of amplitude `other`.
    fn checks_beside(mesh: f64, burst: f64, other: f64, others: OtherMeshes) -> Features {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let pitch = PER_TURN / TEETH as usize;
        let samples = (0..TURNS * PER_TURN).map(|i| {
            let turn = TAU * i as f64 / PER_TURN as f64;
            let lines: f64 = (1..=5)
                .map(|h| mesh * (1.0 + 0.3 * turn.cos()) / f64::from(h) * (f64::from(TEETH * h) * turn).sin())
                .sum();
            let place = i % PER_TURN;
            let hit = if (300..300 + pitch).contains(&place) {
                burst * (TAU * 3.4 * (place - 300) as f64 / pitch as f64).sin()
            } else {
                0.0
            };
            let normal: f64 = StandardNormal.sample(&mut random);
            lines + hit + other * (OTHER_ORDERS * turn).sin() + 0.3 * normal
        });
        let angle_record = AngleRecord {
            unit: "g".into(),
            samples_per_turn: PER_TURN,
            turns: TURNS,
            highest_order: PER_TURN / 2,
            samples: samples.map(|x| x as f32).collect(),
            angle: AngleSource::ConstantSpeed,
        };
        let mut features = Features::default();
        let mesh = MeshContext { others, ..of_teeth(TEETH) };
        insert_tooth_checks(
            &angle_record.without_other_meshes(&mesh),
            &mesh,
            10,
            &mut RecordSpectrum::default(),
            &mut features,
        );
        features
    }

    #[test]
    fn identical_teeth_leave_only_noise() {
        let calm = checks(1.0, 0.0).checks;
        // Noise: as much in the average as in half the difference, kurtosis 3.
        assert!(calm["ln_tooth_repeated_8"].abs() < 0.15, "{calm:?}");
        assert!((calm["ln_tooth_kurtosis_8"] - 0.5 * 3f64.ln()).abs() < 0.15, "{calm:?}");
        assert!((0.1..0.6).contains(&calm["ln_tooth_worst_8"]), "{calm:?}");
        let loud = checks(4.0, 0.0).checks;
        for (name, value) in &calm {
            assert!((value - loud[name]).abs() < 1e-6, "{name}: {value} {}", loud[name]);
        }
    }

    #[test]
    fn a_different_tooth_stands_out() {
        let (calm, cracked) = (checks(1.0, 0.0).checks, checks(1.0, 0.5).checks);
        for (name, least) in
            [("ln_tooth_repeated_8", 0.15), ("ln_tooth_kurtosis_8", 0.3), ("ln_tooth_worst_8", 0.5)]
        {
            assert!(cracked[name] - calm[name] > least, "{name}: {} {}", calm[name], cracked[name]);
        }
    }

    #[test]
    fn a_known_other_mesh_is_not_a_different_tooth() {
        let others =
            OtherMeshes::of([OtherMesh { mesh_orders: OTHER_ORDERS, shaft_orders: [24.0 / 26.0, 0.5] }]);
        let calm = checks_beside(1.0, 0.0, 0.0, others).checks;
        let loud = checks_beside(1.0, 0.0, 5.0, others).checks;
        let unknown = checks_beside(1.0, 0.0, 5.0, OtherMeshes::NONE).checks;
        assert!(
            (unknown["ln_tooth_repeated_8"] - calm["ln_tooth_repeated_8"]).abs() > 0.5,
            "{unknown:?} {calm:?}"
        );
        for (name, value) in &calm {
            assert!((value - loud[name]).abs() < 0.1, "{name}: {value} {}", loud[name]);
        }
    }

    #[test]
    fn few_teeth_and_few_samples_give_no_checks() {
        let angle_record = AngleRecord {
            unit: "g".into(),
            samples_per_turn: 48,
            turns: 4,
            highest_order: 24,
            samples: vec![1.0; 192],
            angle: AngleSource::ConstantSpeed,
        };
        let mut features = Features::default();
        for teeth in [0, 9, 12, 24, u32::MAX] {
            insert_tooth_checks(
                &angle_record,
                &of_teeth(teeth),
                10,
                &mut RecordSpectrum::default(),
                &mut features,
            );
        }
        assert_eq!(features, Features::default());
    }
}
