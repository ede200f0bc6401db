//! The records of a run to failure.

use jiff::{SignedDuration, Timestamp};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use thiserror::Error;

use super::TransmissionPath;
use super::path::SETTLING_S;
use flankwatch_gear::{FlankWear, GearError, GearPair, MeshCycle, PairSpec, RunSettings};
use flankwatch_signal::{MAX_RECORD_SAMPLES, OperatingPoint, Record, RecordError};

/// Positions of the mesh cycle that the dynamics use.
const CYCLE_POINTS: usize = 1000;

/// Settings of a run to failure.
#[derive(Debug, Clone)]
pub struct RunPlan {
    /// The gear pair.
    pub pair: PairSpec,
    /// Number of records.
    pub records: u32,
    /// Length of each in seconds.
    pub seconds: f64,
    /// Sampling rate in hertz.
    pub sample_rate_hz: f64,
    /// Greatest wear depth of the last record in µm.
    pub max_wear_um: f64,
    /// Power of time with which wear grows.
    pub wear_exponent: f64,
    /// Time of the first record.
    pub start_time: Timestamp,
    /// Seconds from one record's start to the next one's.
    pub interval_s: f64,
    /// Ratio of the healthy vibration's RMS to the sensor noise in dB.
    pub snr_db: f64,
    /// The speed of each record lies within this fraction of nominal.
    pub speed_variation: f64,
    /// The torque of each record lies within this fraction of nominal.
    pub torque_variation: f64,
    /// Seed of the path, the noise and the operating points.
    pub seed: u64,
    /// The measuring channel's name.
    pub channel: String,
}

/// Why a run cannot be simulated.
#[derive(Debug, Error)]
pub enum SimulationError {
    /// A number of the plan is out of range.
    #[error("{field} is {value}, expected {expected}")]
    Plan {
        /// Name of the field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// The expected value.
        expected: &'static str,
    },
    /// The run ends after the last time that can be stored.
    #[error(
        "interval_s is {interval_s} and start_time is {start_time}, expected the last of {records} records to start before the year 10000"
    )]
    TooLate {
        /// Seconds from one record's start to the next one's.
        interval_s: f64,
        /// Time of the first record.
        start_time: Timestamp,
        /// Number of records.
        records: u32,
    },
    /// The gear model rejected the pair.
    #[error(transparent)]
    Gear(#[from] GearError),
    /// The simulated samples are not a valid record.
    #[error("the simulated record is not usable: {0}")]
    Record(#[from] RecordError),
}

/// One record of a run, with its true wear.
#[derive(Debug, Clone)]
pub struct SimulatedRecord {
    /// The sensor's record.
    pub record: Record,
    /// Greatest wear depth of the flanks in µm.
    pub wear_um: f64,
}

/// A run that can be simulated record by record, in any order.
pub struct Run {
    plan: RunPlan,
    pair: GearPair,
    path: TransmissionPath,
    noise_deviation: f64,
}

impl Run {
    /// Checks the plan, draws the path, and derives the noise from the healthy vibration.
    pub fn new(plan: RunPlan) -> Result<Self, SimulationError> {
        plan.validate()?;
        let pair = plan.pair.resolve()?;
        let path = TransmissionPath::random(&mut ChaCha8Rng::seed_from_u64(plan.seed), plan.sample_rate_hz);
        let mut run = Self { plan, pair, path, noise_deviation: 0.0 };
        let seconds = run.plan.seconds.min(2.0);
        let healthy = run.vibration(
            0.0,
            seconds,
            run.plan.pair.operation.shaft_speed_hz,
            run.plan.pair.operation.torque_nm,
            run.plan.seed,
            0.0,
        )?;
        let power = healthy.iter().map(|x| x * x).sum::<f64>() / healthy.len() as f64;
        run.noise_deviation = power.sqrt() / 10f64.powf(run.plan.snr_db / 20.0);
        Ok(run)
    }

    /// Returns the plan.
    pub fn plan(&self) -> &RunPlan {
        &self.plan
    }

    /// Returns the greatest wear depth of one record in µm.
    pub fn wear_um(&self, index: u32) -> f64 {
        let last = (self.plan.records.max(2) - 1) as f64;
        self.plan.max_wear_um * (index as f64 / last).powf(self.plan.wear_exponent)
    }

    /// Returns the time of one record's first sample.
    pub fn start_time(&self, index: u32) -> Timestamp {
        self.plan.start_time + self.plan.since_start(index)
    }

    /// Simulates one record; the same plan and index give the same samples.
    pub fn record(&self, index: u32) -> Result<SimulatedRecord, SimulationError> {
        let plan = &self.plan;
        let mut rng = ChaCha8Rng::seed_from_u64(plan.seed);
        rng.set_stream(u64::from(index) + 1);
        let mut vary = |nominal: f64, part: f64| nominal * (1.0 + part * (2.0 * rng.random::<f64>() - 1.0));
        let shaft_speed_hz = vary(plan.pair.operation.shaft_speed_hz, plan.speed_variation);
        let torque_nm = vary(plan.pair.operation.torque_nm, plan.torque_variation);
        let (seed, phase) = (rng.random::<u64>(), rng.random::<f64>());
        let wear_um = self.wear_um(index);
        let seen = self.vibration(wear_um, plan.seconds, shaft_speed_hz, torque_nm, seed, phase)?;
        let samples = seen
            .iter()
            .map(|x| {
                let noise: f64 = StandardNormal.sample(&mut rng);
                (x + self.noise_deviation * noise) as f32
            })
            .collect();
        let record =
            Record::new(plan.channel.clone(), self.start_time(index), plan.sample_rate_hz, "m/s2", samples)?;
        // The speed is not given, as on a machine without a tachometer.
        let record = record.with_operating_point(OperatingPoint {
            torque_nm: Some(torque_nm),
            ..OperatingPoint::default()
        })?;
        Ok(SimulatedRecord { record, wear_um })
    }

    fn vibration(
        &self,
        wear_um: f64,
        seconds: f64,
        shaft_speed_hz: f64,
        torque_nm: f64,
        seed: u64,
        phase: f64,
    ) -> Result<Vec<f64>, SimulationError> {
        let wear = FlankWear::from_shape(&self.pair, wear_um * 1e-3)?;
        let cycle = MeshCycle::compute(&self.pair, &wear, CYCLE_POINTS)?;
        let settings = RunSettings {
            sample_rate_hz: self.plan.sample_rate_hz,
            seconds: seconds + SETTLING_S,
            shaft_speed_hz,
            torque_nm,
            seed,
            start_phase_turns: phase,
        };
        let seen = self.path.apply(&flankwatch_gear::simulate(&self.pair, &cycle, &settings)?);
        let wanted = (seconds * self.plan.sample_rate_hz).round() as usize;
        Ok(seen[seen.len() - wanted.min(seen.len())..].to_vec())
    }
}

impl RunPlan {
    fn validate(&self) -> Result<(), SimulationError> {
        let checks = [
            ("records", f64::from(self.records), 1.0..=1e6, "a number from 1 to 1000000"),
            ("seconds", self.seconds, 0.1..=600.0, "a length from 0.1 to 600 s"),
            ("sample_rate_hz", self.sample_rate_hz, 1000.0..=1e6, "a rate from 1000 to 1000000 Hz"),
            (
                "seconds × sample_rate_hz",
                self.seconds * self.sample_rate_hz,
                0.0..=MAX_RECORD_SAMPLES as f64,
                "at most 16777216 samples a record",
            ),
            ("max_wear_um", self.max_wear_um, 0.0..=1e4, "a depth from 0 to 10000 µm"),
            ("wear_exponent", self.wear_exponent, 0.1..=10.0, "a number from 0.1 to 10"),
            ("interval_s", self.interval_s, 0.0..=1e7, "a time from 0 to 10000000 s"),
            ("snr_db", self.snr_db, -60.0..=200.0, "a ratio from -60 to 200 dB"),
            ("speed_variation", self.speed_variation, 0.0..=0.5, "a fraction from 0 to 0.5"),
            ("torque_variation", self.torque_variation, 0.0..=0.9, "a fraction from 0 to 0.9"),
        ];
        for (field, value, range, expected) in checks {
            if !range.contains(&value) {
                return Err(SimulationError::Plan { field, value, expected });
            }
        }
        if self.start_time.checked_add(self.since_start(self.records - 1)).is_err() {
            let Self { interval_s, start_time, records, .. } = *self;
            return Err(SimulationError::TooLate { interval_s, start_time, records });
        }
        Ok(())
    }

    /// Returns the time from the first record's start to that of another.
    fn since_start(&self, index: u32) -> SignedDuration {
        SignedDuration::from_secs_f64(self.interval_s * f64::from(index))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan() -> RunPlan {
        RunPlan {
            pair: PairSpec::from_toml(include_str!("../../../../fixtures/pairs/shen2022.toml")).unwrap(),
            records: 3,
            seconds: 1.0,
            sample_rate_hz: 20_000.0,
            max_wear_um: 245.0,
            wear_exponent: 1.5,
            start_time: Timestamp::UNIX_EPOCH,
            interval_s: 60.0,
            snr_db: 10.0,
            speed_variation: 0.0,
            torque_variation: 0.0,
            seed: 1,
            channel: "x".to_owned(),
        }
    }

    #[test]
    fn invalid_plans_are_rejected_by_field() {
        let late = "9999-12-30T00:00:00Z".parse().unwrap();
        for (plan, expected) in [
            (
                RunPlan { records: 30_000, interval_s: 1e7, ..plan() },
                "interval_s is 10000000 and start_time is 1970-01-01T00:00:00Z, expected the last of 30000 records",
            ),
            (
                RunPlan { records: 2, interval_s: 1e7, start_time: late, ..plan() },
                "interval_s is 10000000 and start_time is 9999-12-30T00:00:00Z",
            ),
            (
                RunPlan { seconds: 17.0, sample_rate_hz: 1e6, ..plan() },
                "seconds × sample_rate_hz is 17000000, expected at most 16777216 samples a record",
            ),
            (RunPlan { sample_rate_hz: 10.0, ..plan() }, "sample_rate_hz is 10, expected"),
            (RunPlan { max_wear_um: -1.0, ..plan() }, "max_wear_um is -1, expected"),
        ] {
            let error = plan.validate().unwrap_err().to_string();
            assert!(error.starts_with(expected), "{error}");
        }
        assert!(plan().validate().is_ok());
        assert!(RunPlan { records: 1, interval_s: 1e7, start_time: late, ..plan() }.validate().is_ok());
    }
}
