//! A real bearing's run to failure (Nectoux et al. 2012): indicators, envelope and kurtogram of every record.

use std::fs::File;

use flankwatch::recording::{Cut, RecordDefaults, WavBlocks};
use flankwatch::signal::{AnalysisSettings, Analyzer, BandSource, EnvelopeSearch, MeshContext};

use flankwatch_test_support::recordings;

/// Root mean square of the first and of the last tenth, from the data's own README.
const RMS: [f64; 2] = [0.38, 1.42];

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

#[test]
#[ignore = "needs the folder of real recordings"]
fn a_bearing_that_fails_gets_louder_and_every_record_has_a_band() {
    let folder = recordings("bearing-femto-1_1");
    let path = folder.join("horizontal-2803x2560-25600Hz.wav");
    let bytes = path.metadata().unwrap().len();
    let defaults = RecordDefaults { unit: Some("g".to_owned()), ..RecordDefaults::default() };
    let records =
        WavBlocks::new(File::open(&path).unwrap(), bytes, &defaults, Some(Cut::Samples(2560))).unwrap();
    let mut analyzer = Analyzer::new(AnalysisSettings::default());
    let (mut rms, mut kurtosis) = (Vec::new(), Vec::new());
    for record in records {
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
