//! The native part of the Python package `flankwatch`: signal processing, the gear model and the wear
//! estimate, over NumPy arrays.
//!
//! Each function validates its arguments, releases the interpreter while it computes, and returns the same
//! numbers as the program.

mod angle;
mod arguments;
mod error;
mod frequency;
mod library;
mod mesh;
mod pair;
mod record;
mod recording;
mod run;
mod tracker;

use pyo3::prelude::*;

/// Signal processing, gear model and wear estimate.
#[pymodule]
mod _flankwatch {
    #[pymodule_export]
    use super::angle::{AngleRecord, GearSignals, OrderSpectrum, angle_record, gear_signals, order_spectrum};
    #[pymodule_export]
    use super::frequency::{
        Cepstrum, EnvelopeSpectrum, Kurtogram, Spectrum, amplitude_spectrum, cepstrum, condition,
        envelope_spectrum, kurtogram, power_spectral_density,
    };
    #[pymodule_export]
    use super::library::{Ensemble, Library};
    #[pymodule_export]
    use super::mesh::{Flank, MeshCycle, ToothContact};
    #[pymodule_export]
    use super::pair::{Pair, Simulation};
    #[pymodule_export]
    use super::recording::read_frames;
    #[pymodule_export]
    use super::run::{Run, SimulatedRecord};
    #[pymodule_export]
    use super::tracker::Tracker;
}
