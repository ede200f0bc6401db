//! The figures of Shen et al. 2022 computed with this model, and tests of the paper's statements about them.
//!
//! Figs. 7, 8 and 11 show one pair of teeth, 12 to 15 and 18 the whole mesh, 17 a comparison with finite
//! elements, 19 to 22 the vibration. This module computes numbers; it draws nothing.

mod check;
mod finite_elements;
mod flanks;
mod mesh;
mod trend;
mod vibration;

use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;
use serde::Serialize;
use thiserror::Error;

use flankwatch_gear::{FlankWear, GearError, GearPair, MODEL_VERSION, PairSpec};
use flankwatch_signal::{BandError, RecordError};

pub use check::Check;
pub use finite_elements::FiniteElementPoint;
pub use flanks::{FlankCurve, ToothPair};
pub use mesh::Mesh;
pub use vibration::{IndicatorState, Lines, Vibration, VibrationFigures};

/// Settings of the figures.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FigureSettings {
    /// Greatest wear depths of Wear01, Wear02 and Wear03 in µm, rising.
    pub wear_um: [f64; 3],
    /// Number of wear states of Fig. 22.
    pub states: u32,
    /// Increase of the greatest wear depth from one of these states to the next, in µm.
    pub step_um: f64,
    /// Number of the worn state in Figs. 19 to 21; the other is state 0.
    pub worn_num: u32,
    /// Length of each record in seconds.
    pub seconds: f64,
    /// Sampling rate in hertz.
    pub sample_rate_hz: f64,
}

impl Default for FigureSettings {
    /// The paper's 50 states of 5 µm and its state 40. The paper does not state the rest: records of 10 s at
    /// 20 kHz, and 50, 100 and 150 µm for its three degrees of wear.
    fn default() -> Self {
        Self {
            wear_um: [50.0, 100.0, 150.0],
            states: 50,
            step_um: 5.0,
            worn_num: 40,
            seconds: 10.0,
            sample_rate_hz: 20_000.0,
        }
    }
}

/// Why the figures cannot be computed.
#[derive(Debug, Error)]
pub enum FiguresError {
    /// A setting is out of range.
    #[error("{field} is {value}, expected {expected}")]
    Setting {
        /// Name of the field.
        field: &'static str,
        /// Its value.
        value: String,
        /// The expected value.
        expected: &'static str,
    },
    /// The gear model rejected the pair.
    #[error(transparent)]
    Gear(#[from] GearError),
    /// The simulated samples are not a valid record.
    #[error("the simulated record is not usable: {0}")]
    Record(#[from] RecordError),
    /// The record has no envelope spectrum.
    #[error("the simulated record has no envelope: {0}")]
    Envelope(#[from] BandError),
    /// An indicator could not be computed.
    #[error(
        "wear state {num} has no {name}: records are too short or sampled too slowly for the mesh frequency"
    )]
    NoIndicator {
        /// Number of the state.
        num: u32,
        /// Name of the indicator.
        name: &'static str,
    },
}

/// One of the states of Figs. 7 to 18.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MeshState {
    /// Name in the figures.
    pub name: &'static str,
    /// Greatest wear depth in µm.
    pub wear_um: f64,
    /// One pair of teeth (Figs. 7, 8, 11).
    pub tooth_pair: ToothPair,
    /// The whole mesh (Figs. 12 to 15, 18a).
    pub mesh: Mesh,
    /// Total transmission error along the line of action in µm over one turn of the driving shaft, without
    /// its random part (Fig. 18b).
    pub transmission_error_um: Vec<f64>,
}

/// The numbers of all figures, and the checks.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figures {
    /// Version of the gear model.
    pub model_version: &'static str,
    /// The gear pair.
    pub pair: PairSpec,
    /// The settings.
    pub settings: FigureSettings,
    /// No wear, Wear01, Wear02, Wear03.
    pub states: Vec<MeshState>,
    /// Shaft turns at which [`MeshState::transmission_error_um`] is given.
    pub turns: Vec<f64>,
    /// Finite-element stiffness of perfect flanks (Fig. 17); empty for any pair but the table's.
    pub finite_elements: Vec<FiniteElementPoint>,
    /// Figs. 19 to 22.
    pub vibration: VibrationFigures,
    /// Checks of the paper's statements, by figure.
    pub checks: Vec<Check>,
}

impl FigureSettings {
    fn check(&self) -> Result<(), FiguresError> {
        let refuse = |field, value: String, expected| Err(FiguresError::Setting { field, value, expected });
        let [slight, moderate, severe] = self.wear_um;
        if !(slight > 0.0 && moderate > slight && severe > moderate && severe.is_finite()) {
            return refuse("wear_um", format!("{:?}", self.wear_um), "three rising depths above 0");
        }
        if !(2..=1000).contains(&self.states) {
            return refuse("states", self.states.to_string(), "a number from 2 to 1000");
        }
        if !(self.step_um > 0.0 && self.step_um.is_finite()) {
            return refuse("step_um", self.step_um.to_string(), "a finite depth above 0");
        }
        if !(1..self.states).contains(&self.worn_num) {
            return refuse("worn_num", self.worn_num.to_string(), "a worn state's number");
        }
        if !(self.seconds >= 0.5 && self.seconds <= 600.0) {
            return refuse("seconds", self.seconds.to_string(), "a length from 0.5 to 600 s");
        }
        Ok(())
    }
}

/// Computes all figures, the states of Fig. 22 in parallel; `progress` is called with the number of finished
/// states. The result depends on the inputs alone, not on the number of threads.
///
/// # Errors
/// [`FiguresError`] for an invalid setting, or where the gear model rejects the pair.
pub fn compute(
    spec: &PairSpec,
    settings: &FigureSettings,
    progress: &(dyn Fn(usize) + Sync),
) -> Result<Figures, FiguresError> {
    settings.check()?;
    let pair = spec.resolve()?;
    let (states, turns) = mesh_states(&pair, settings)?;
    let finite_elements = finite_elements::points(spec);
    let vibration = vibration_figures(&pair, settings, progress)?;

    let (tooth_pairs, meshes): (Vec<_>, Vec<_>) =
        states.iter().map(|state| (state.tooth_pair.clone(), state.mesh.clone())).unzip();
    let mut checks = flanks::checks(&tooth_pairs);
    checks.extend(mesh::checks(&pair, &tooth_pairs, &meshes));
    checks.extend(finite_elements::checks(&meshes[0], &finite_elements));
    checks.extend(vibration.checks(settings.seconds));
    checks.sort_by_key(|check| check.figure);
    Ok(Figures {
        model_version: MODEL_VERSION,
        pair: spec.clone(),
        settings: *settings,
        states,
        turns,
        finite_elements,
        vibration,
        checks,
    })
}

fn mesh_states(
    pair: &GearPair,
    settings: &FigureSettings,
) -> Result<(Vec<MeshState>, Vec<f64>), FiguresError> {
    let [slight, moderate, severe] = settings.wear_um;
    let named = [("No wear", 0.0), ("Wear01", slight), ("Wear02", moderate), ("Wear03", severe)];
    let mut turns = Vec::new();
    let mut states = Vec::with_capacity(named.len());
    for (name, wear_um) in named {
        let wear =
            if wear_um > 0.0 { FlankWear::from_shape(pair, wear_um * 1e-3)? } else { FlankWear::none() };
        let tooth_pair = ToothPair::compute(pair, &wear)?;
        let mesh = Mesh::compute(pair, &wear, &tooth_pair)?;
        let error = mesh::transmission_error_um(pair, &mesh);
        turns = error.0;
        states.push(MeshState { name, wear_um, tooth_pair, mesh, transmission_error_um: error.1 });
    }
    Ok((states, turns))
}

fn vibration_figures(
    pair: &GearPair,
    settings: &FigureSettings,
    progress: &(dyn Fn(usize) + Sync),
) -> Result<VibrationFigures, FiguresError> {
    let done = AtomicUsize::new(0);
    let states = (0..settings.states)
        .into_par_iter()
        .map(|num| {
            let state = vibration::state(pair, settings, num, num == 0 || num == settings.worn_num)?;
            progress(done.fetch_add(1, Ordering::Relaxed) + 1);
            Ok(state)
        })
        .collect::<Result<Vec<_>, FiguresError>>()?;
    let (indicators, drawn): (Vec<_>, Vec<_>) = states.into_iter().unzip();
    let drawn: Vec<_> = drawn.into_iter().flatten().collect();
    let drawn = <[Vibration; 2]>::try_from(drawn).expect("the unworn and one worn state are drawn");
    Ok(VibrationFigures::new(pair, indicators, drawn))
}

#[cfg(test)]
mod tests {
    use super::{FigureSettings, FiguresError, compute};
    use flankwatch_gear::PairSpec;

    fn shen2022() -> PairSpec {
        PairSpec::from_toml(include_str!("../../../../fixtures/pairs/shen2022.toml")).unwrap()
    }

    /// Three states of the 50, of 1 s.
    fn short() -> FigureSettings {
        FigureSettings { states: 3, step_um: 100.0, worn_num: 2, seconds: 1.0, ..FigureSettings::default() }
    }

    #[test]
    fn statements_about_the_mesh_hold_as_documented() {
        let figures = compute(&shen2022(), &short(), &|_| ()).unwrap();
        // docs/model.md: all of Figs. 7 to 18 hold but the two of Fig. 17 that elastic teeth refute.
        let refuted: Vec<_> =
            figures.checks.iter().filter(|check| check.figure < 19 && !check.holds).collect();
        assert_eq!(refuted.len(), 2, "{refuted:?}");
        assert!(refuted.iter().all(|check| check.figure == 17), "{refuted:?}");
        for number in [7, 8, 11, 12, 13, 14, 15, 17, 18, 19, 20, 21, 22] {
            assert!(figures.checks.iter().any(|check| check.figure == number), "Fig. {number}");
        }
        assert_eq!(figures.vibration.indicators.len(), 3);
        assert_eq!(figures.vibration.states[1].wear_um, 200.0);
    }

    #[test]
    fn other_pairs_have_no_finite_element_table() {
        let mut spec = shen2022();
        spec.geometry.teeth = [30, 41];
        spec.geometry.centre_distance_mm = None;
        let figures = compute(&spec, &short(), &|_| ()).unwrap();
        assert!(figures.finite_elements.is_empty());
        assert!(figures.checks.iter().all(|check| check.figure != 17));
    }

    #[test]
    fn invalid_settings_are_rejected() {
        let cases = [
            ("wear_um", FigureSettings { wear_um: [50.0, 40.0, f64::NAN], ..short() }),
            ("states", FigureSettings { states: 1, ..short() }),
            ("step_um", FigureSettings { step_um: f64::INFINITY, ..short() }),
            ("step_um", FigureSettings { step_um: 0.0, ..short() }),
            ("worn_num", FigureSettings { worn_num: 3, ..short() }),
            ("seconds", FigureSettings { seconds: f64::NAN, ..short() }),
        ];
        for (field, settings) in cases {
            let refusal = compute(&shen2022(), &settings, &|_| ()).unwrap_err();
            assert!(
                matches!(&refusal, FiguresError::Setting { field: named, .. } if *named == field),
                "{refusal}"
            );
        }
        let deep = FigureSettings { wear_um: [50.0, 100.0, 9000.0], ..short() };
        assert!(
            compute(&shen2022(), &deep, &|_| ()).unwrap_err().to_string().starts_with("wear depth in mm")
        );
    }
}
