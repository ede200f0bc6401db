//! Simulated faults of the machine and of the sensor.

use std::f64::consts::TAU;

use rand::RngExt;
use serde::{Deserialize, Serialize};

/// A fault that starts at some record of a run and lasts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// One tooth of the driving gear has lost half of its stiffness.
    CrackedTooth,
    /// Impacts of a bearing's outer race that ring at a structure's resonance.
    BearingLines,
    /// Strong lines at one and two shaft rates.
    Misalignment,
    /// The sensor's sensitivity doubles.
    GainJump,
    /// The sensor's sensitivity halves.
    GainDrop,
    /// The converter's range ends at half of the last peak before the fault.
    Clipping,
    /// The sensor's output is constant.
    Dead,
    /// The sensor is loose: frequencies above a low resonance are blocked.
    LooseMount,
}

impl Fault {
    /// All faults.
    pub const ALL: [Self; 8] = [
        Self::CrackedTooth,
        Self::BearingLines,
        Self::Misalignment,
        Self::GainJump,
        Self::GainDrop,
        Self::Clipping,
        Self::Dead,
        Self::LooseMount,
    ];

    /// Returns the name.
    pub fn name(self) -> &'static str {
        match self {
            Self::CrackedTooth => "one cracked tooth",
            Self::BearingLines => "bearing lines",
            Self::Misalignment => "misalignment",
            Self::GainJump => "gain jump",
            Self::GainDrop => "gain drop",
            Self::Clipping => "clipping",
            Self::Dead => "dead sensor",
            Self::LooseMount => "loose mount",
        }
    }
}

/// Root mean square of bearing impacts over that of the healthy vibration.
const BEARING_PART: f64 = 0.5;
/// Outer-race passes per turn of the shaft, for 9 balls.
const PASSES_A_TURN: f64 = 3.58;
/// Resonance that the impacts ring at, and its damping ratio.
const RING_HZ: f64 = 3300.0;
const RING_DAMPING: f64 = 0.04;
/// Root mean square of the shaft lines over that of the healthy vibration.
const SHAFT_PARTS: [f64; 2] = [0.5, 0.8];
/// A loose mount's resonance and damping.
const LOOSE_HZ: f64 = 1500.0;
const LOOSE_DAMPING: f64 = 0.2;
/// End of the converter's range, as a part of the last peak before the fault.
const CLIPPED_PART: f64 = 0.5;
/// Factor by which the sensitivity is multiplied or divided.
const GAIN: f64 = 2.0;

/// Adds a fault's excitation to the vibration before the transmission path; `healthy_rms` is its RMS without
/// it.
pub(super) fn excite(
    fault: Fault,
    vibration: &mut [f64],
    rate_hz: f64,
    shaft_hz: f64,
    healthy_rms: f64,
    rng: &mut impl RngExt,
) {
    match fault {
        Fault::BearingLines => {
            let (mut y1, mut y2) = (0.0, 0.0);
            let radius = (-RING_DAMPING * TAU * RING_HZ / rate_hz).exp();
            let turn = 2.0 * radius * (TAU * RING_HZ / rate_hz).cos();
            let period = rate_hz / (shaft_hz * PASSES_A_TURN);
            let mut next = period * rng.random::<f64>();
            let ring: Vec<f64> = (0..vibration.len())
                .map(|n| {
                    let hit = n as f64 >= next;
                    if hit {
                        // Rolling elements slip a little.
                        next += period * (1.0 + 0.01 * (rng.random::<f64>() - 0.5));
                    }
                    let y = turn * y1 - radius * radius * y2 + f64::from(u8::from(hit));
                    (y2, y1) = (y1, y);
                    y
                })
                .collect();
            let rms = (ring.iter().map(|x| x * x).sum::<f64>() / ring.len() as f64).sqrt();
            let scale = BEARING_PART * healthy_rms / rms.max(f64::MIN_POSITIVE);
            vibration.iter_mut().zip(ring).for_each(|(x, y)| *x += scale * y);
        }
        Fault::Misalignment => {
            let phases: [f64; 2] = [rng.random(), rng.random()];
            for (n, x) in vibration.iter_mut().enumerate() {
                let turns = shaft_hz * n as f64 / rate_hz;
                for k in 0..2 {
                    let order = k as f64 + 1.0;
                    *x += SHAFT_PARTS[k]
                        * healthy_rms
                        * 2.0_f64.sqrt()
                        * (TAU * (order * turns + phases[k])).sin();
                }
            }
        }
        _ => {}
    }
}

/// Applies a sensor fault to the signal with its noise; `peak` is that of the last record before the fault.
pub(super) fn distort(fault: Fault, seen: &mut [f64], rate_hz: f64, peak: f64) {
    match fault {
        Fault::GainJump => seen.iter_mut().for_each(|x| *x *= GAIN),
        Fault::GainDrop => seen.iter_mut().for_each(|x| *x /= GAIN),
        Fault::Clipping => {
            seen.iter_mut().for_each(|x| *x = x.clamp(-CLIPPED_PART * peak, CLIPPED_PART * peak))
        }
        Fault::Dead => seen.fill(0.0),
        Fault::LooseMount => {
            // A second-order low-pass by impulse invariance.
            let omega = TAU * LOOSE_HZ / rate_hz;
            let radius = (-LOOSE_DAMPING * omega).exp();
            let turn = 2.0 * radius * (omega * (1.0 - LOOSE_DAMPING * LOOSE_DAMPING).sqrt()).cos();
            let gain = 1.0 - turn + radius * radius;
            let (mut y1, mut y2) = (0.0, 0.0);
            for x in seen.iter_mut() {
                let y = gain * *x + turn * y1 - radius * radius * y2;
                (y2, y1) = (y1, y);
                *x = y;
            }
        }
        Fault::CrackedTooth | Fault::BearingLines | Fault::Misalignment => {}
    }
}
