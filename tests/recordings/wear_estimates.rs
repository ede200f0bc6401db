//! Wear estimates of recorded machines, and the gearbox that several tests use.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use flankwatch::estimate::{EstimatorSettings, Tracker, WearEstimate};
use flankwatch::gear::PairSpec;
use flankwatch::library::{BuildControl, Ensemble, GridSettings, build};
use flankwatch::signal::{AnalysisSettings, Analyzer, Features, MeshContext, Record};
use flate2::read::GzDecoder;
use jiff::{SignedDuration, Timestamp};

/// Samples per piece of a gearbox recording (0.4 s), and number of healthy pieces in the baseline.
pub(super) const PIECE: usize = 5120;
pub(super) const GEARBOX_RATE_HZ: f64 = 12_800.0;
pub(super) const GEARBOX_BASELINE: usize = 12;

pub(super) fn ensemble(pair: &PairSpec, max_wear_um: f64, sample_rate_hz: f64) -> Arc<Ensemble> {
    let grid =
        GridSettings { states: 12, max_wear_um, seconds: 0.5, sample_rate_hz, ..GridSettings::default() };
    let library = build(pair, &grid, &BuildControl::silent()).unwrap();
    Arc::new(Ensemble::of(Arc::new(library)))
}

pub(super) fn mesh(pair: &PairSpec) -> MeshContext {
    MeshContext::new(pair.geometry.teeth, pair.operation.shaft_speed_hz, 0.05)
}

pub(super) fn at(index: usize) -> Timestamp {
    Timestamp::UNIX_EPOCH + SignedDuration::from_secs(10 * index as i64)
}

pub(super) fn estimate(
    baseline: usize,
    ensemble: Option<Arc<Ensemble>>,
    records: impl Iterator<Item = Features>,
) -> Vec<WearEstimate> {
    let settings = EstimatorSettings { baseline_records: baseline as u32, limit_um: None };
    let tracker = Tracker::new(settings, ensemble);
    let mut state = tracker.start();
    let records = records.enumerate();
    records.map(|(index, features)| tracker.update(&mut state, at(index), &features)).collect()
}

/// Returns all channels of a recording of the gearbox.
pub(super) fn channels(folder: &Path, name: &str) -> [Vec<f32>; 4] {
    let text = GzDecoder::new(File::open(folder.join(format!("{name}.csv.gz"))).unwrap());
    let mut rows = csv::Reader::from_reader(text);
    let mut columns: [Vec<f32>; 4] = Default::default();
    for row in rows.records() {
        for (column, value) in columns.iter_mut().zip(row.unwrap().iter()) {
            column.push(value.trim().parse().unwrap());
        }
    }
    columns
}

/// Splits samples into pieces of a length.
pub(super) fn pieces(samples: &[f32], piece: usize, mesh: &MeshContext) -> Vec<Features> {
    pieces_at(samples, piece, mesh, GEARBOX_RATE_HZ)
}

pub(super) fn pieces_at(samples: &[f32], piece: usize, mesh: &MeshContext, rate_hz: f64) -> Vec<Features> {
    let mut analyzer = Analyzer::new(AnalysisSettings::default());
    let features = |samples: &[f32]| {
        let record = Record::new("1", Timestamp::UNIX_EPOCH, rate_hz, "1", samples.to_vec()).unwrap();
        analyzer.analyze(&record, mesh).features
    };
    samples.chunks_exact(piece).map(features).collect()
}

/// The gearbox with teeth and speed as its spectra have them; module, width and torque are guessed, as the
/// data do not say them.
pub(super) fn gearbox() -> PairSpec {
    PairSpec::from_toml(
        "[geometry]\nteeth = [32, 96]\nmodule_mm = 1.5\nface_width_mm = 12.0\npressure_angle_deg = 20.0\nbore_radius_mm = [8.0, 8.0]\n\
         [operation]\ntorque_nm = 5.0\nshaft_speed_hz = 29.7\n[errors]\nlong_period_um = 5.0\nshort_period_um = 2.0\n",
    )
    .unwrap()
}
