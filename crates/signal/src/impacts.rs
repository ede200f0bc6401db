//! Impacts in the envelope of a record: the lines of the configured bearings, and the strongest line.

use super::analyzer::{Analysis, Analyzer};
use super::bearing::Bearing;
use super::bearing_lines::EnvelopeLines;
use super::envelope::{EnvelopeBand, EnvelopeSearch, band_bins};
use super::indicators::Indicators;
use super::not_computed::NotComputed;
use super::record::RecordOf;
use super::speed::SpeedSource;

/// The strongest line is searched up to this fraction of the sampling rate.
const MAX_LINE_FRACTION: f64 = 1.0 / 16.0;

/// Without configured bearings, a record is examined from this kurtosis on.
const IMPULSIVE_KURTOSIS: f64 = 4.0;

/// The bearings, and how to choose the band of their impacts.
#[derive(Debug, Clone, Copy, Default)]
pub struct BearingSettings<'a> {
    /// The bearings.
    pub bearings: &'a [Bearing],
    /// The band of the envelope in hertz, if configured.
    pub band_hz: Option<[f64; 2]>,
    /// How to choose the band otherwise: `Kurtogram` takes the kurtogram's band; `MeshHarmonic` takes 1/16 to
    /// 45 % of the sampling rate, independent of the mesh.
    pub search: EnvelopeSearch,
}

impl Analyzer {
    /// Adds the bearings' lines to the indicators and the envelope's strongest line to the features of the
    /// record that was transformed last.
    pub(super) fn insert_impacts(
        &mut self,
        record: &RecordOf<'_>,
        settings: &BearingSettings<'_>,
        tolerance: f64,
        analysis: &mut Analysis,
    ) {
        let bearings = settings.bearings;
        let kurtosis = analysis.indicators.get("kurtosis");
        let is_impulsive = kurtosis.is_some_and(|kurtosis| kurtosis > IMPULSIVE_KURTOSIS);
        if bearings.is_empty() && !is_impulsive {
            return;
        }
        let band_hz = self.impact_band(record, settings);
        let work = &mut self.work;
        let band = match band_bins(band_hz, work.length, record.sample_rate_hz()) {
            _ if kurtosis.is_none() => Err(NotComputed::Constant),
            Ok(band) => Ok(band),
            Err(error) => Err(error.not_computed()),
        };
        let band = match band {
            Ok(band) => band,
            Err(reason) => return insert_missing(bearings, reason, &mut analysis.indicators),
        };
        work.envelope.compute(&work.bins, work.length, band, &mut work.transforms);
        let lines = EnvelopeLines {
            amplitude: &work.envelope.amplitude,
            resolution_hz: work.resolution_hz(record),
            shaft: analysis.shaft_speed.map(|speed| {
                let is_nominal = speed.source == SpeedSource::Nominal;
                (speed.shaft_speed_hz, if is_nominal { tolerance } else { 0.0 })
            }),
        };
        let detected = lines.indicate(bearings, &mut work.sorting, &mut analysis.indicators);
        let highest_hz = MAX_LINE_FRACTION * record.sample_rate_hz();
        analysis.features.envelope_line = lines.strongest(&detected, band_hz, highest_hz, &mut work.sorting);
    }

    fn impact_band(&mut self, record: &RecordOf<'_>, settings: &BearingSettings<'_>) -> [f64; 2] {
        let default_band = EnvelopeBand::of_impacts(record.sample_rate_hz()).band_hz;
        match (settings.band_hz, settings.search) {
            (Some(band_hz), _) => band_hz,
            (None, EnvelopeSearch::Kurtogram) => {
                let kurtogram = self.kurtogram_transformed(record);
                kurtogram.map_or(default_band, |kurtogram| kurtogram.best.band_hz)
            }
            (None, EnvelopeSearch::MeshHarmonic) => default_band,
        }
    }
}

fn insert_missing(bearings: &[Bearing], reason: NotComputed, indicators: &mut Indicators) {
    for bearing in bearings {
        for name in bearing.all_indicators() {
            indicators.insert(name, Err(reason));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use jiff::Timestamp;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::super::{
        AnalysisSettings, BearingLine, BearingOrders, ConditionSettings, LineSource, MeshContext,
        OperatingPoint,
    };
    use super::*;
    use crate::Record;

    const RATE_HZ: f64 = 20_000.0;
    const SHAFT_HZ: f64 = 29.3;

    /// Impacts on the outer race of a bearing of 9 balls: the mean rate is 1 % below that of pure rolling.
    fn bearing_fault(seconds: f64, impact: f64, seed: u64) -> Record {
        impacts(0.99 * orders().bpfo * SHAFT_HZ, SHAFT_HZ, seconds, impact, seed)
    }

    /// Impacts that ring at 4.3 kHz, in noise; each comes up to 1 % of the interval early or late.
    fn impacts(impact_hz: f64, shaft_hz: f64, seconds: f64, impact: f64, seed: u64) -> Record {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let count = (seconds * RATE_HZ) as usize;
        let mut samples: Vec<f64> = (0..count)
            .map(|i| {
                let noise: f64 = StandardNormal.sample(&mut random);
                noise + 0.8 * (TAU * shaft_hz * i as f64 / RATE_HZ).sin()
            })
            .collect();
        let interval = RATE_HZ / impact_hz;
        let mut at = 0.3 * interval;
        while at.ceil() < count as f64 {
            let first = at.ceil() as usize;
            for (after, sample) in samples[first..].iter_mut().take(200).enumerate() {
                let t = ((first + after) as f64 - at) / RATE_HZ;
                *sample += impact * (-t / 6e-4).exp() * (TAU * 4300.0 * t).sin();
            }
            at += interval * (1.0 + random.random_range(-0.01..0.01));
        }
        let samples = samples.into_iter().map(|x| x as f32).collect();
        let point = OperatingPoint { shaft_speed_hz: Some(shaft_hz), ..OperatingPoint::default() };
        Record::new("a", Timestamp::UNIX_EPOCH, RATE_HZ, "m/s2", samples)
            .unwrap()
            .with_operating_point(point)
            .unwrap()
    }

    fn orders() -> BearingOrders {
        BearingOrders::of_geometry(9, 0.2034, 0.0)
    }

    fn analysed(record: &Record, band_hz: Option<[f64; 2]>) -> Analysis {
        analysed_with(orders(), record, band_hz)
    }

    fn analysed_with(orders: BearingOrders, record: &Record, band_hz: Option<[f64; 2]>) -> Analysis {
        let bearings = [Bearing { name: "de".into(), shaft_turns: 1.0, orders }];
        let settings = ConditionSettings {
            mesh: MeshContext::unknown(),
            bands: &[],
            gear_indicators: false,
            bearings: BearingSettings { bearings: &bearings, band_hz, ..BearingSettings::default() },
        };
        Analyzer::new(AnalysisSettings::default()).condition(record, &settings).analysis
    }

    fn ratios(analysis: &Analysis) -> [f64; 4] {
        BearingLine::ALL
            .map(|line| analysis.indicators.values[&format!("bearing_de_{}_to_background", line.name())])
    }

    #[test]
    fn only_an_outer_race_fault_is_detected_and_named() {
        for seed in 0..10 {
            let analysis = analysed(&bearing_fault(2.0, 3.0, seed), None);
            let [bpfo, others @ ..] = ratios(&analysis);
            assert!(bpfo > 6.0 && others.iter().all(|ratio| *ratio < 3.0), "{bpfo} {others:?}");
            let line = analysis.features.envelope_line.unwrap();
            let LineSource::Bearing { line: of, harmonic, .. } = line.source.clone().unwrap() else {
                panic!("{line:?}");
            };
            assert_eq!(of, BearingLine::Bpfo, "{line:?}");
            let slipped = f64::from(harmonic) * 0.99 * orders().bpfo * SHAFT_HZ;
            assert!((line.frequency_hz / slipped - 1.0).abs() < 0.003, "{line:?}");
            let words = format!("the outer race of bearing de ({harmonic} × BPFO)");
            assert!(line.words().contains(&words), "{}", line.words());
        }
    }

    /// A band around the resonance leaves noise out; the amplitude grows with the impacts.
    #[test]
    fn the_amplitude_follows_the_impacts() {
        let band = Some([3300.0, 5300.0]);
        let amplitude =
            |impact: f64| analysed(&bearing_fault(4.0, impact, 1), band).indicators.values["bearing_de_bpfo"];
        let [first, second] = [40.0, 80.0].map(amplitude);
        assert!((second / first - 2.0).abs() < 0.1, "{first} {second}");
    }

    #[test]
    fn noise_has_no_line() {
        let mut highest = 0.0_f64;
        for seed in 0..100 {
            let analysis = analysed(&bearing_fault(1.0, 0.0, 100 + seed), None);
            highest = ratios(&analysis).into_iter().fold(highest, f64::max);
            assert_eq!(analysis.features.envelope_line, None);
        }
        assert!(highest < 2.9, "{highest}");
    }

    /// SKF 6203: BPFO 3.053 and BPFI 4.947 lie beside the third and the fifth multiple of the shaft's rate.
    #[test]
    fn a_line_hidden_by_the_shaft_is_absent_and_not_read_as_another() {
        let orders = BearingOrders { bpfo: 3.053, bpfi: 4.947, bsf: 1.994, ftf: 0.382 };
        let shaft_hz = 25.0;
        for seconds in [0.4, 0.75, 1.0, 1.5, 2.0, 6.0, 10.0] {
            for (seed, slip) in [(1, 0.99), (2, 0.995), (3, 1.0)] {
                let record = impacts(slip * orders.bpfo * shaft_hz, shaft_hz, seconds, 6.0, seed);
                let Analysis { indicators, features, .. } = analysed_with(orders, &record, None);
                let case = format!("{seconds} s, {slip}: {indicators:?}");
                let of = |name: &str| indicators.get(&format!("bearing_de_{name}_to_background"));
                assert!(indicators.values.iter().all(|(_, value)| *value != 0.0), "{case}");
                assert!(of("bpfo").is_none_or(|ratio| ratio > 6.0), "{case}");
                assert!(
                    ["bpfi", "bsf"].iter().all(|name| of(name).is_none_or(|ratio| ratio < 3.0)),
                    "{case}"
                );
                match seconds {
                    0.4..=1.5 => {
                        assert_eq!(indicators.absent["bearing_de_bpfo"], NotComputed::OtherLine, "{case}");
                    }
                    6.0.. => {
                        assert!(of("bpfo").is_some() && of("bpfi").is_some(), "{case}");
                        let source = features.envelope_line.unwrap().source.unwrap();
                        assert!(
                            matches!(source, LineSource::Bearing { line: BearingLine::Bpfo, .. }),
                            "{case}"
                        );
                    }
                    _ => {}
                }
            }
        }
    }

    /// Closed form: 8 rolling elements of a quarter of the pitch diameter have BPFO = 3.
    #[test]
    fn a_line_at_a_multiple_of_the_shaft_rate_is_never_read_as_healthy() {
        let orders = BearingOrders::of_geometry(8, 0.25, 0.0);
        for (seconds, slip) in [(1.0, 1.0), (10.0, 1.0), (10.0, 0.998)] {
            let record = impacts(slip * orders.bpfo * 25.0, 25.0, seconds, 6.0, 1);
            let absent = analysed_with(orders, &record, None).indicators.absent;
            assert_eq!(absent["bearing_de_bpfo"], NotComputed::OtherLine, "{seconds} {slip}");
        }
        let slipping = impacts(0.985 * orders.bpfo * 25.0, 25.0, 10.0, 6.0, 1);
        let ratio = analysed_with(orders, &slipping, None).indicators.values["bearing_de_bpfo_to_background"];
        assert!(ratio > 6.0, "{ratio}");
    }

    #[test]
    fn unreadable_lines_report_the_reason() {
        let short = analysed(&bearing_fault(0.1, 3.0, 0), None);
        assert_eq!(short.indicators.absent["bearing_de_ftf"], NotComputed::TooShort);
        let narrow = analysed(&bearing_fault(1.0, 3.0, 0), Some([4200.0, 4300.0]));
        assert_eq!(narrow.indicators.absent["bearing_de_bpfi"], NotComputed::AboveEnvelope);
        let above = analysed(&bearing_fault(1.0, 3.0, 0), Some([4200.0, 14_300.0]));
        assert_eq!(above.indicators.absent["bearing_de_bpfo_to_background"], NotComputed::AboveNyquist);
        let constant = Record::new("a", Timestamp::UNIX_EPOCH, RATE_HZ, "g", vec![1.0; 5000]).unwrap();
        assert_eq!(analysed(&constant, None).indicators.absent["bearing_de_bpfo"], NotComputed::Constant);
        let unknown = bearing_fault(1.0, 3.0, 0).with_operating_point(OperatingPoint::default()).unwrap();
        assert_eq!(analysed(&unknown, None).indicators.absent["bearing_de_bpfo"], NotComputed::NoSpeed);
    }
}
