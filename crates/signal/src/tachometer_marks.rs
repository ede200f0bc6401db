//! Where the marks of a tachometer lie on its shaft: the teeth of a wheel or the stripes of a tape are never
//! spaced evenly, and a tape has a joint.

/// Fewest whole turns over which the marks' places are averaged.
const MIN_TURNS: usize = 8;

/// The marks count as uneven if their offsets exceed these means' standard errors by this factor, root mean
/// square over the marks.
const MIN_OFFSET_RATIO: f64 = 3.0;

/// Returns how far each mark of a turn lies from even spacing about the first one, in intervals; `None` if
/// there are too few turns, or if the scatter of the pulses explains the offsets.
///
/// A mark's place is the mean over all turns of the angle at its pulses. The angle is the cubic through four
/// passages of the first mark, so that a steady change of the speed moves no mark.
pub(super) fn mark_offsets(times_s: &[f64], marks: usize) -> Option<Vec<f64>> {
    let passages: Vec<f64> = times_s.iter().step_by(marks.max(1)).copied().collect();
    let turns = passages.len().saturating_sub(1);
    if marks < 2 || turns < MIN_TURNS {
        return None;
    }
    let mut sums = vec![[0.0; 2]; marks];
    for (turn, pulses) in times_s.chunks_exact(marks).take(turns).enumerate() {
        let first = turn.saturating_sub(1).min(turns - 3);
        let angle = Angle::through(std::array::from_fn(|passage| passages[first + passage]));
        for ((mark, time_s), [sum, squares]) in pulses.iter().enumerate().zip(&mut sums) {
            let in_turn = first as f64 + angle.at(*time_s) - turn as f64;
            let offset = in_turn * marks as f64 - mark as f64;
            (*sum, *squares) = (*sum + offset, *squares + offset * offset);
        }
    }
    let count = turns as f64;
    let offsets: Vec<f64> = sums.iter().map(|[sum, _]| sum / count).collect();
    let of_means: f64 = offsets.iter().map(|offset| offset * offset).sum();
    let of_all: f64 = sums.iter().map(|[_, squares]| squares / count).sum();
    let squared_errors = (of_all - of_means).max(0.0) / (count - 1.0);
    let is_uneven = of_means > MIN_OFFSET_RATIO * MIN_OFFSET_RATIO * squared_errors;
    let ascends = offsets.windows(2).all(|w| w[1] - w[0] > -1.0) && offsets[marks - 1] < 1.0;
    (is_uneven && ascends).then_some(offsets)
}

/// The cubic that is 0, 1, 2 and 3 at four times, in Newton's form.
struct Angle {
    times_s: [f64; 4],
    differences: [f64; 4],
}

impl Angle {
    fn through(times_s: [f64; 4]) -> Self {
        let mut differences = [0.0, 1.0, 2.0, 3.0];
        for order in 1..4 {
            for i in (order..4).rev() {
                differences[i] = (differences[i] - differences[i - 1]) / (times_s[i] - times_s[i - order]);
            }
        }
        Self { times_s, differences }
    }

    fn at(&self, time_s: f64) -> f64 {
        let ([t0, t1, t2, _], [c0, c1, c2, c3]) = (self.times_s, self.differences);
        c0 + (time_s - t0) * (c1 + (time_s - t1) * (c2 + (time_s - t2) * c3))
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use jiff::Timestamp;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::super::{AnalysisSettings, Analyzer, Indicators, MeshContext, Record, Tachometer};
    use super::*;

    const TEETH: u32 = 24;
    const RATE_HZ: f64 = 20_000.0;

    /// Seconds at which a shaft that speeds up from 16 Hz by `ramp` Hz each second reaches a revolution.
    fn time_s(revolution: f64, ramp: f64) -> f64 {
        if ramp == 0.0 { revolution / 16.0 } else { ((256.0 + 2.0 * ramp * revolution).sqrt() - 16.0) / ramp }
    }

    /// Pulses of marks at these places in turns, each late or early by `jitter_s`.
    fn pulses(marks: &[f64], turns: u32, ramp: f64, jitter_s: f64) -> Vec<f64> {
        let mut random = ChaCha8Rng::seed_from_u64(11);
        let places = (0..turns).flat_map(|turn| marks.iter().map(move |mark| f64::from(turn) + mark));
        let mut jitter = || -> f64 {
            jitter_s * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut random)
        };
        places.map(|place| time_s(place, ramp) + jitter()).collect()
    }

    fn even(count: u32) -> Vec<f64> {
        (0..count).map(|mark| f64::from(mark) / f64::from(count)).collect()
    }

    /// A tape whose last interval, at the joint, is 30 % longer.
    fn jointed(count: u32) -> Vec<f64> {
        (0..count).map(|mark| f64::from(mark) / (f64::from(count) + 0.3)).collect()
    }

    /// A wheel with a pitch error of 0.3° root mean square.
    fn inaccurate(count: u32) -> Vec<f64> {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let error = || -> f64 { StandardNormal.sample(&mut random) };
        let errors: Vec<f64> = std::iter::repeat_with(error).take(count as usize).collect();
        even(count).iter().zip(errors).map(|(mark, error)| mark + 0.3 / 360.0 * error).collect()
    }

    /// The indicators of a mesh with one local fault, at the angle that the marks give.
    fn indicators(marks: &[f64], ramp: f64, jitter_s: f64) -> Indicators {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let samples: Vec<f32> = (0..200_000)
            .map(|i| {
                let t = f64::from(i) / RATE_HZ;
                let turn = TAU * (16.0 * t + 0.5 * ramp * t * t);
                let lines: f64 = (1..=5)
                    .map(|h| (1.0 + 0.1 * turn.cos()) / f64::from(h) * (f64::from(TEETH * h) * turn).sin())
                    .sum();
                let noise: f64 = StandardNormal.sample(&mut random);
                (lines + 0.3 * noise) as f32
            })
            .collect();
        let tachometer = Tachometer {
            pulse_times_s: pulses(marks, 210, ramp, jitter_s),
            pulses_per_revolution: marks.len() as u32,
        };
        let record = Record::new("1", Timestamp::UNIX_EPOCH, RATE_HZ, "m/s2", samples).unwrap();
        let mesh = MeshContext::new([TEETH, 0], 16.0, 0.05);
        Analyzer::new(AnalysisSettings::default())
            .gear_indicators(&record.with_tachometer(Some(tachometer)), &mesh)
            .0
    }

    #[test]
    fn even_marks_stay_even() {
        for (count, ramp) in [(2, 0.0), (12, 0.0), (60, 0.0), (12, 0.8), (60, 0.8)] {
            let offsets = mark_offsets(&pulses(&even(count), 100, ramp, 20e-6), count as usize);
            assert_eq!(offsets, None, "{count} {ramp}");
        }
        assert_eq!(mark_offsets(&pulses(&jointed(60), 7, 0.0, 0.0), 60), None);
        assert_eq!(mark_offsets(&pulses(&even(1), 100, 0.0, 0.0), 1), None);
        assert_eq!(mark_offsets(&[0.0, 1.0], usize::MAX), None);
        assert_eq!(mark_offsets(&[], 0), None);
    }

    #[test]
    fn places_of_uneven_marks_are_found_at_any_speed() {
        for marks in [jointed(60), inaccurate(12), vec![0.0, 0.51]] {
            let first = marks[0];
            for ramp in [0.0, 0.8, -0.8] {
                let offsets = mark_offsets(&pulses(&marks, 100, ramp, 2e-6), marks.len()).unwrap();
                for (k, offset) in offsets.iter().enumerate() {
                    let want = (marks[k] - first) * marks.len() as f64 - k as f64;
                    assert!((offset - want).abs() < 1e-3, "{k} of {}, {ramp}: {offset} {want}", marks.len());
                }
            }
        }
    }

    /// Marks that were taken as evenly spaced gave an FM4 of 11 and more, and read OMX up to 13 % too low.
    #[test]
    fn uneven_marks_read_as_even_ones() {
        for ramp in [0.0, 0.4] {
            let want = indicators(&even(60), ramp, 2e-6).values;
            for marks in [jointed(60), inaccurate(12), vec![0.0, 0.51]] {
                let got = indicators(&marks, ramp, 2e-6).values;
                for (name, tolerance) in
                    [("omx_tracked", 0.005), ("sideband_energy_ratio", 0.05), ("fm4", 0.15), ("fm0", 0.05)]
                {
                    let change = got[name] / want[name] - 1.0;
                    let case = format!("{} marks, {ramp}: {name} {} {}", marks.len(), got[name], want[name]);
                    assert!(change.abs() < tolerance, "{case}");
                }
            }
        }
    }
}
