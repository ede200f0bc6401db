//! A real bearing's run to failure (Nectoux et al. 2012): indicators, envelope and kurtogram of every record.

use std::collections::BTreeMap;

use flankwatch::recording::{Cut, FileFrames, RecordBlocks, RecordDefaults};
use flankwatch::signal::{
    AnalysisSettings, Analyzer, BandSource, Bearing, BearingLine, BearingOrders, BearingSettings,
    ConditionSettings, EnvelopeSearch, MeshContext,
};

use flankwatch_test_support::recordings;

/// Root mean square of the first and of the last tenth, from the data's own README.
const RMS: [f64; 2] = [0.38, 1.42];

/// Ratio to its background above which a line stands out: the level of the alarms of a described bearing.
const STANDING_OUT: f64 = 3.0;

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

fn records() -> RecordBlocks<FileFrames> {
    let folder = recordings("bearing-femto-1_1");
    let path = folder.join("horizontal-2803x2560-25600Hz.wav");
    let defaults = RecordDefaults { unit: Some("g".to_owned()), ..RecordDefaults::default() };
    RecordBlocks::new(FileFrames::open(path, &[]).unwrap(), &defaults, Some(Cut::Samples(2560))).unwrap()
}

#[test]
#[ignore = "needs the folder of real recordings"]
fn a_bearing_that_fails_gets_louder_and_every_record_has_a_band() {
    let mut analyzer = Analyzer::new(AnalysisSettings::default());
    let (mut rms, mut kurtosis) = (Vec::new(), Vec::new());
    for record in records() {
        let record = record.unwrap();
        rms.push(analyzer.analyze(&record, &MeshContext::unknown()).indicators.get("rms").unwrap());
        let band = analyzer.envelope_band(&record, None, EnvelopeSearch::Kurtogram);
        assert_eq!(band.source, BandSource::Kurtogram);
        let [low, high] = band.band_hz;
        assert!((0.0..high).contains(&low) && high <= 12_800.0, "{band:?}");
        kurtosis.push(band.spectral_kurtosis.unwrap());
        let envelope = analyzer.envelope_spectrum(&record, band.band_hz).unwrap();
        assert!(
            envelope.amplitude.iter().all(|a| a.is_finite()) && envelope.amplitude.iter().any(|a| *a > 0.0)
        );
    }
    assert_eq!(rms.len(), 2803);
    let tenth = rms.len() / 10;
    let ends = [median(&rms[..tenth]), median(&rms[rms.len() - tenth..])];
    for (got, want) in ends.iter().zip(RMS) {
        assert!((got / want - 1.0).abs() < 0.02, "{ends:?}");
    }
    // Its impacts stand out of noise, whose best band has about 1.
    let late = median(&kurtosis[rms.len() - tenth..]);
    assert!(kurtosis.iter().all(|k| k.is_finite()) && late > 1.0, "{late}");
}

/// The bearing of the test rig by its geometry: 13 rolling elements of 3.5 mm on 25.6 mm, at 1800 turns a
/// minute. In a record of 0.1 s a turn has three bins and a line of the outer race hides among the shaft's;
/// that of the inner race stands out at the end.
#[test]
#[ignore = "needs the folder of real recordings"]
fn the_lines_of_a_failing_bearing_stand_out_before_failure() {
    let orders = BearingOrders::of_geometry(13, 3.5 / 25.6, 0.0);
    let bearings = [Bearing { name: "test".into(), shaft_turns: 1.0, orders }];
    let settings = ConditionSettings {
        mesh: MeshContext { nominal_shaft_speed_hz: 30.0, nominal_is_exact: true, ..MeshContext::unknown() },
        bands: &[],
        gear_indicators: true,
        bearings: BearingSettings { bearings: &bearings, ..BearingSettings::default() },
    };
    let mut analyzer = Analyzer::new(AnalysisSettings::default());
    let ratios: Vec<BTreeMap<BearingLine, f64>> = records()
        .map(|record| {
            let indicators = analyzer.condition(&record.unwrap(), &settings).analysis.indicators;
            let ratio =
                |line: &BearingLine| Some((*line, indicators.get(&bearings[0].ratio_indicator(*line))?));
            BearingLine::ALL.iter().filter_map(ratio).collect()
        })
        .collect();
    // Next to a strong line, another line may have no background.
    let of = |line: BearingLine| -> Vec<f64> {
        ratios.iter().map(|ratios| ratios.get(&line).copied().unwrap_or(0.0)).collect()
    };
    for line in [BearingLine::Bpfo, BearingLine::Bpfi, BearingLine::Bsf] {
        let of_line = of(line);
        let standing: Vec<usize> = (0..of_line.len()).filter(|n| of_line[*n] >= STANDING_OUT).collect();
        let lasting =
            of_line.windows(5).position(|five| five.iter().filter(|r| **r >= STANDING_OUT).count() >= 3);
        eprintln!(
            "{}: first stands out in record {:?}, in three of five from {lasting:?}; {} records; median of the first 2500 {:.2}, of the last 40 {:.2}",
            line.name(),
            standing.first(),
            standing.len(),
            median(&of_line[..2500]),
            median(&of_line[of_line.len() - 40..])
        );
        assert!(standing.iter().filter(|n| **n < 1000).count() <= 10, "{}", line.name());
    }
    assert!(ratios.iter().all(|ratios| !ratios.contains_key(&BearingLine::Ftf)), "1.3 bins are not resolved");
    let late = |line: BearingLine| median(&of(line)[ratios.len() - 40..]);
    assert!(late(BearingLine::Bpfi) > 1.3 * late(BearingLine::Bpfo).max(late(BearingLine::Bsf)));
}
