//! Mesh and vibration of a previewed pair, cached between slider steps.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use serde::Serialize;

use super::refusal::Refusal;
use super::vibration::{Vibration, VibrationPlan};
use crate::gear::{
    ContactRule, ElasticBodies, Flank, FlankWear, GearError, GearPair, MODEL_VERSION, MeshCycle, PairSpec,
    WearShape,
};

/// Maximum number of cached pairs (least recently used first out).
const MAX_PAIRS: usize = 12;

/// Maximum number of operating points with a cached unworn state per pair.
const MAX_POINTS: usize = 8;

/// Positions of the mesh period.
const CYCLE_POINTS: usize = 200;

/// Intervals of a flank.
const FLANK_STRETCHES: usize = 60;

/// Steps of Archard wear, which accumulates from the unworn flanks.
const ARCHARD_STEPS: usize = 24;

/// Operating point and wear.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Conditions {
    pub(crate) wear_um: f64,
    pub(crate) torque_nm: f64,
    pub(crate) shaft_speed_hz: f64,
}

/// Mesh and vibration of the pair, unworn and worn.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = PreviewModel)]
pub(crate) struct ModelView {
    /// Maximum wear depth in µm.
    wear_um: f64,
    /// Torque on the driving gear in N·m.
    torque_nm: f64,
    /// Rotational frequency of the driving shaft in hertz.
    shaft_speed_hz: f64,
    /// Mesh frequency in hertz.
    mesh_hz: f64,
    /// Contact rule: which pairs of teeth carry the load.
    contact: ContactRule,
    /// Version of the gear model.
    model_version: &'static str,
    /// Worn flanks of the driving and the driven gear.
    flanks: Vec<FlankView>,
    /// Without wear.
    #[schema(value_type = StateView)]
    unworn: Arc<StateView>,
    /// With wear.
    #[schema(value_type = StateView)]
    worn: Arc<StateView>,
    /// Mesh harmonics of the expected acceleration.
    harmonics: Vec<HarmonicView>,
}

/// A gear's working flank from the start of its active profile to the tip, in tooth coordinates: x along the
/// centre line from the gear's centre, y half of the unworn thickness.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = PreviewFlank)]
struct FlankView {
    /// Its coordinate along the tooth's centre line in mm.
    x_mm: Vec<f32>,
    /// Its distance from the centre line in mm.
    y_mm: Vec<f32>,
    /// Wear depth there in µm, along y.
    depth_um: Vec<f32>,
}

/// One mesh period and the resulting vibration.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = PreviewState)]
struct StateView {
    /// Angle of the driving gear over one mesh period in rad.
    phi1_rad: Vec<f32>,
    /// Angle of the driven gear's mating tooth in rad, without load.
    phi2_rad: Vec<f32>,
    /// Mesh stiffness at each angle in N/m.
    stiffness_n_per_m: Vec<f32>,
    /// Unloaded static transmission error at each angle in rad.
    uste_rad: Vec<f32>,
    /// Number of tooth pairs that carry load at each angle.
    pairs_in_contact: Vec<u32>,
    /// The expected acceleration.
    vibration: Vibration,
}

/// A mesh harmonic of the expected acceleration.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = PreviewHarmonic)]
struct HarmonicView {
    /// Its number, 1 for the mesh frequency.
    harmonic: u32,
    /// Its frequency in hertz.
    frequency_hz: f64,
    /// Peak amplitude without wear in m/s².
    unworn_m_per_s2: f64,
    /// Peak amplitude with wear in m/s².
    worn_m_per_s2: f64,
    /// The change in dB.
    change_db: f64,
}

/// Cached pairs, so that a slider step only computes the worn state.
#[derive(Debug, Default)]
pub(crate) struct PreviewModels {
    models: Mutex<VecDeque<(String, Arc<PairModel>)>>,
}

/// A pair with everything that does not depend on its wear.
#[derive(Debug)]
struct PairModel {
    spec: PairSpec,
    pair: GearPair,
    bodies: Option<ElasticBodies>,
    /// Archard-worn flanks, from unworn to the maximum depth.
    course: OnceLock<Result<Vec<FlankWear>, Refusal>>,
    unworn: Mutex<VecDeque<([u64; 2], Arc<StateView>)>>,
}

impl PreviewModels {
    /// Computes the model's predictions under these conditions, or why there are none.
    pub(crate) fn view(&self, spec: &PairSpec, conditions: &Conditions) -> Result<ModelView, Refusal> {
        self.of(spec)?.view(conditions)
    }

    fn of(&self, spec: &PairSpec) -> Result<Arc<PairModel>, Refusal> {
        let key = serde_json::to_string(spec).unwrap_or_default();
        let lock = || self.models.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = latest(&mut lock(), &key) {
            return Ok(known);
        }
        let made = Arc::new(PairModel::new(spec).map_err(|error| Refusal::of_pair(&error))?);
        insert(&mut lock(), key, Arc::clone(&made), MAX_PAIRS);
        Ok(made)
    }
}

/// Looks up a cached value and marks it as most recently used.
fn latest<K: PartialEq, V: Clone>(entries: &mut VecDeque<(K, V)>, key: &K) -> Option<V> {
    let place = entries.iter().position(|(known, _)| known == key)?;
    let entry = entries.remove(place)?;
    let value = entry.1.clone();
    entries.push_back(entry);
    Some(value)
}

fn insert<K, V>(entries: &mut VecDeque<(K, V)>, key: K, value: V, capacity: usize) {
    while entries.len() >= capacity {
        entries.pop_front();
    }
    entries.push_back((key, value));
}

impl PairModel {
    /// Checks the pair like an asset's pair.
    fn new(spec: &PairSpec) -> Result<Self, GearError> {
        let pair = spec.check()?;
        let loaded = spec.dynamics.contact == ContactRule::Loaded;
        Ok(Self {
            bodies: loaded.then(|| ElasticBodies::new(&pair, &FlankWear::none())).transpose()?,
            spec: spec.clone(),
            pair,
            course: OnceLock::new(),
            unworn: Mutex::default(),
        })
    }

    fn view(&self, conditions: &Conditions) -> Result<ModelView, Refusal> {
        let (wear, wear_um) = self.wear(conditions.wear_um)?;
        let pair = self.running(conditions)?;
        let unworn = self.unworn(&pair, conditions)?;
        let worn =
            if wear_um > 0.0 { Arc::new(self.state(&pair, &wear, conditions)?) } else { Arc::clone(&unworn) };
        let mesh_hz = conditions.shaft_speed_hz * f64::from(pair.gears[0].teeth);
        let pairs = unworn.vibration.harmonics().iter().zip(worn.vibration.harmonics());
        let harmonics = (1..).zip(pairs).map(|(harmonic, (before, after))| HarmonicView {
            harmonic,
            frequency_hz: mesh_hz * f64::from(harmonic),
            unworn_m_per_s2: *before,
            worn_m_per_s2: *after,
            change_db: 20.0 * (after / before).log10(),
        });
        Ok(ModelView {
            wear_um,
            torque_nm: conditions.torque_nm,
            shaft_speed_hz: conditions.shaft_speed_hz,
            mesh_hz,
            contact: self.spec.dynamics.contact,
            model_version: MODEL_VERSION,
            flanks: (0..2).map(|index| FlankView::of(&pair, &wear, index)).collect(),
            harmonics: harmonics.collect(),
            unworn,
            worn,
        })
    }

    /// The flanks at a depth in µm, and the depth actually reached.
    fn wear(&self, wear_um: f64) -> Result<(FlankWear, f64), Refusal> {
        if self.spec.wear.shape != WearShape::Archard {
            let wear = FlankWear::from_shape(&self.pair, wear_um * 1e-3)
                .map_err(|error| Refusal::of_conditions(&error))?;
            return Ok((wear, wear_um));
        }
        let step_um = self.spec.usual_wear_um() / ARCHARD_STEPS as f64;
        let course = self.course.get_or_init(|| {
            let depths: Vec<f64> = (0..=ARCHARD_STEPS).map(|step| step as f64 * step_um * 1e-3).collect();
            FlankWear::from_shape_coarse_at(&self.pair, &depths)
                .map_err(|error| Refusal::of_conditions(&error))
        });
        let course = course.as_ref().map_err(Clone::clone)?;
        let step = ((wear_um / step_um).round() as usize).min(ARCHARD_STEPS);
        Ok((course[step].clone(), step as f64 * step_um))
    }

    /// The pair at the torque and speed of the conditions.
    fn running(&self, conditions: &Conditions) -> Result<GearPair, Refusal> {
        let mut spec = self.spec.clone();
        let factor = conditions.torque_nm / spec.operation.torque_nm;
        if let Some(output) = &mut spec.operation.output_torque_nm {
            *output *= factor;
        }
        spec.operation.torque_nm = conditions.torque_nm;
        spec.operation.shaft_speed_hz = conditions.shaft_speed_hz;
        spec.resolve().map_err(|error| Refusal::of_conditions(&error))
    }

    fn unworn(&self, pair: &GearPair, conditions: &Conditions) -> Result<Arc<StateView>, Refusal> {
        let key = [conditions.torque_nm.to_bits(), conditions.shaft_speed_hz.to_bits()];
        let lock = || self.unworn.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = latest(&mut lock(), &key) {
            return Ok(known);
        }
        let made = Arc::new(self.state(pair, &FlankWear::none(), conditions)?);
        insert(&mut lock(), key, Arc::clone(&made), MAX_POINTS);
        Ok(made)
    }

    fn state(
        &self,
        pair: &GearPair,
        wear: &FlankWear,
        conditions: &Conditions,
    ) -> Result<StateView, Refusal> {
        let refused = |error: GearError| Refusal::of_conditions(&error);
        let cycle = MeshCycle::coarse(pair, self.bodies.as_ref(), wear, CYCLE_POINTS).map_err(refused)?;
        let plan = VibrationPlan::new(pair, conditions.torque_nm, conditions.shaft_speed_hz);
        Ok(StateView {
            vibration: plan.simulate(pair, &cycle).map_err(refused)?,
            phi1_rad: short(&cycle.phi1_rad),
            phi2_rad: short(&cycle.phi2_rad),
            stiffness_n_per_m: short(&cycle.stiffness_n_per_m),
            uste_rad: short(&cycle.uste_rad),
            pairs_in_contact: cycle.pairs_in_contact,
        })
    }
}

impl FlankView {
    fn of(pair: &GearPair, wear: &FlankWear, index: usize) -> Self {
        let points: Vec<_> =
            Flank::new(&pair.gears[index], wear, index).active_points(FLANK_STRETCHES).collect();
        Self {
            x_mm: points.iter().map(|point| point.x_mm as f32).collect(),
            y_mm: points.iter().map(|point| point.y_mm as f32).collect(),
            depth_um: points.iter().map(|point| (point.depth_mm * 1e3) as f32).collect(),
        }
    }
}

/// Rounds values to the precision of a drawing.
fn short(values: &[f64]) -> Vec<f32> {
    values.iter().map(|value| *value as f32).collect()
}
