//! Runs drawn from a bank: features of each record with known true wear.

use jiff::Timestamp;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::bank::Bank;
use super::fault::Fault;
use super::sensor::{Kernel, Sensor};
use flankwatch_signal::{AnalysisSettings, Analyzer, Features, MeshContext, OperatingPoint, Record};
use flankwatch_wear::simulation::TransmissionPath;

/// Settings that the runs of one case share.
#[derive(Debug, Clone, Copy)]
pub struct RunShape {
    /// Number of records over which wear grows.
    pub records: usize,
    /// Number of records that are drawn, from the first on.
    pub drawn: usize,
    /// Length of each in seconds.
    pub seconds: f64,
    /// Healthy vibration over sensor noise in dB, after the path.
    pub snr_db: f64,
    /// Relative variation of the speed within a record.
    pub wander: f64,
    /// Wear of the last record in µm; 0 for a run that stays healthy.
    pub last_wear_um: f64,
    /// A fault, and the record from which it lasts.
    pub fault: Option<(Fault, usize)>,
}

/// One record of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Observation {
    /// True greatest depth in µm.
    pub wear_um: f64,
    /// Features of the record.
    pub features: Features,
    /// Its root mean square, kurtosis and first mesh line (OMX), for comparison.
    pub single: [f64; 3],
}

/// Returns the observations of one run in time order; the same arguments give the same run.
///
/// Wear grows from 0 as a power of the record's index; the power is drawn between 1.2 and 1.8. `faulty` is
/// the bank from the fault's first record on, for a fault that changes the dynamics.
pub fn observe(bank: &Bank, faulty: Option<&Bank>, settings: &RunShape, seed: u64) -> Vec<Observation> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let plan = &bank.plan;
    let path = TransmissionPath::random(&mut rng, plan.sample_rate_hz);
    let power: f64 = rng.random_range(1.2..1.8);
    let mut sensor = Sensor {
        path,
        noise_deviation: 0.0,
        healthy_rms: 0.0,
        peak: 0.0,
        wander: settings.wander,
        sample_rate_hz: plan.sample_rate_hz,
        kernel: Kernel::new(),
    };
    let calm = sensor.record(&bank.healthy[0], settings.seconds, None, &mut rng);
    let rms = |samples: &[f32]| {
        (samples.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>() / samples.len() as f64).sqrt()
    };
    sensor.noise_deviation = rms(&calm) / 10f64.powf(settings.snr_db / 20.0);
    sensor.healthy_rms = rms(&bank.healthy[0].samples);

    let mut analyzer = Analyzer::new(AnalysisSettings::default());
    let mesh = MeshContext::new(plan.pair.geometry.teeth, plan.pair.operation.shaft_speed_hz, 0.05);
    let mut reached_um: f64 = 0.0;
    (0..settings.drawn.min(settings.records))
        .map(|index| {
            let wear_um =
                settings.last_wear_um * (index as f64 / (settings.records.max(2) - 1) as f64).powf(power);
            let fault = settings.fault.and_then(|(fault, first)| (index >= first).then_some(fault));
            let bank = match (fault, faulty) {
                (Some(_), Some(faulty)) => faulty,
                _ => bank,
            };
            let vibration = bank.near(wear_um, reached_um, &mut rng);
            reached_um = reached_um.max(vibration.wear_um);
            let samples = sensor.record(vibration, settings.seconds, fault, &mut rng);
            if fault.is_none() {
                sensor.peak = samples.iter().fold(0.0, |most, &x| f64::max(most, f64::from(x.abs())));
            }
            let record = Record::new("1", Timestamp::UNIX_EPOCH, plan.sample_rate_hz, "m/s2", samples)
                .and_then(|record| {
                    record.with_operating_point(OperatingPoint {
                        torque_nm: Some(vibration.torque_nm),
                        ..OperatingPoint::default()
                    })
                })
                .expect("a simulated vibration is finite, and its rate and torque were checked by the model");
            let analysis = analyzer.analyze(&record, &mesh);
            let single = ["rms", "kurtosis", "omx"].map(|name| analysis.indicators.get(name).unwrap_or(0.0));
            Observation { wear_um: vibration.wear_um, features: analysis.features, single }
        })
        .collect()
}
