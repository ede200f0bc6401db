//! Members of the ensemble: mesh lines and transmission error of one possible pair over wear.

use flankwatch_signal::Name;
use serde::{Deserialize, Serialize};

use super::super::Library;
use super::depths::DEPTHS;
use super::line_changes::MESH_LINES;
use super::prior;
use flankwatch_gear::{
    ContactRule, ElasticBodies, FlankWear, GearError, GearPair, MeshCycle, PairSpec, RunSettings, WearShape,
    simulate_together,
};

/// Members with the same gears and the same wear; they differ in damping, supports and the teeth's small
/// errors. They share mesh cycles, which take most of a member's computing time.
pub const VARIANTS: usize = 4;

/// Positions of the mesh cycle.
const CYCLE_POINTS: usize = 500;

/// Samples per mesh period, and mesh periods of a response: whole periods make Fourier coefficients exact.
const SAMPLES_A_PERIOD: f64 = 40.0;
const PERIODS: f64 = 2.0;

/// Least amplitude in m/s² whose logarithm is taken.
const MIN_AMPLITUDE: f64 = 1e-12;

/// A place on the flank where wear may be measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum FlankPlace {
    /// The deepest point.
    #[default]
    Greatest,
    /// The start of the active profile.
    Root,
    /// The pitch point.
    Pitch,
    /// The tip.
    Tip,
}

/// Wear of one possible pair. Tables have one entry per depth of the ensemble.
#[derive(Debug, Clone, PartialEq)]
pub struct Member {
    /// Number of the draw; `None` for the described library itself.
    pub(super) draw: Option<usize>,
    /// Contact rule of the pair.
    pub contact: ContactRule,
    /// Mesh damping ratio ζ of the pair.
    pub mesh_damping_ratio: f64,
    /// Whether its wear follows Archard's law.
    pub archard: bool,
    /// Peak-to-peak transmission error that wear adds under load, in µm along the line of action.
    pub(super) transmission_error_um: Vec<f32>,
    /// By gear, place (root, pitch, tip, greatest) and depth: local depth over the greatest of both gears.
    pub(super) places: Vec<f32>,
}

/// A member with the changes of its lines.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Simulated {
    pub(super) member: Member,
    /// By line and depth: natural logarithm of the amplitude over that of the unworn pair; NaN where it is
    /// not known.
    pub(super) changes: Vec<f32>,
}

impl Simulated {
    /// Returns the described library on a grid of depths in µm. Its transmission error follows from the
    /// stored mesh cycles; its depth at every place is taken to be the greatest.
    pub(super) fn described(library: &Library, depths_um: &[f64]) -> Self {
        let states: Vec<f64> = library.states().iter().map(|state| state.wear_um).collect();
        let curves = library.feature_curves();
        let mut changes = Vec::with_capacity(MESH_LINES * DEPTHS);
        for line in 0..MESH_LINES {
            let curve = curves.get(line_name(line).as_str());
            changes.extend(depths_um.iter().map(|um| match curve {
                Some(curve) => (interpolated(&states, curve, *um) - curve[0]) as f32,
                None => f32::NAN,
            }));
        }
        let pair = library.pair();
        let errors: Vec<Vec<f64>> = match pair.resolve() {
            Ok(pair) => library
                .states()
                .iter()
                .map(|state| errors_um(&pair, &state.cycle.uste_rad, &state.cycle.stiffness_n_per_m))
                .collect(),
            Err(_) => vec![Vec::new(); states.len()],
        };
        let peak_to_peak = peak_to_peak_um(&errors);
        let member = Member {
            draw: None,
            contact: pair.dynamics.contact,
            mesh_damping_ratio: pair.dynamics.mesh_damping_ratio,
            archard: pair.wear.shape == WearShape::Archard,
            transmission_error_um: depths_um
                .iter()
                .map(|um| interpolated(&states, &peak_to_peak, *um) as f32)
                .collect(),
            places: vec![1.0; 8 * DEPTHS],
        };
        Self { member, changes }
    }

    /// Draws [`VARIANTS`] pairs of the same gears and wear and simulates them at depths in µm.
    pub(super) fn drawn(
        described: &PairSpec,
        draw: usize,
        depths_um: &[f64],
    ) -> Result<Vec<Self>, GearError> {
        let mut drawn = prior::draw(described, draw as u32, VARIANTS as u32)?;
        match Self::of_drawn(&drawn, draw, depths_um) {
            // Rigid flanks of this shape lose contact or vibrate without bound; elastic ones do neither.
            Err(GearError::NoContact { .. } | GearError::Unstable { .. })
                if drawn.contact() == Some(ContactRule::Threshold) =>
            {
                drawn.specs.iter_mut().for_each(|spec| spec.dynamics.contact = ContactRule::Loaded);
                Self::of_drawn(&drawn, draw, depths_um)
            }
            members => members,
        }
    }

    fn of_drawn(drawn: &prior::Drawn, draw: usize, depths_um: &[f64]) -> Result<Vec<Self>, GearError> {
        let Some(spec) = drawn.specs.first() else {
            return Ok(Vec::new());
        };
        let pair = spec.resolve()?;
        let depths_mm: Vec<f64> = depths_um.iter().map(|um| um * 1e-3).collect();
        let worn = FlankWear::from_shape_coarse_at(&pair, &depths_mm)?;
        // The teeth's compliance changes little with wear, so the bodies of the unworn gears are used.
        let bodies = match spec.dynamics.contact {
            ContactRule::Loaded if drawn.independent_teeth => Some(ElasticBodies::independent_teeth(&pair)?),
            ContactRule::Loaded => Some(ElasticBodies::new(&pair, &FlankWear::none())?),
            ContactRule::Threshold => None,
        };
        let cycles: Vec<MeshCycle> = worn
            .iter()
            .map(|wear| MeshCycle::coarse(&pair, bodies.as_ref(), wear, CYCLE_POINTS))
            .collect::<Result<_, _>>()?;
        let errors: Vec<Vec<f64>> =
            cycles.iter().map(|cycle| errors_um(&pair, &cycle.uste_rad, &cycle.stiffness_n_per_m)).collect();
        let transmission_error_um: Vec<f32> =
            peak_to_peak_um(&errors).into_iter().map(|um| um as f32).collect();
        let places = places(&pair, &worn, &depths_mm);
        let member = |spec: &PairSpec| {
            let member = Member {
                draw: Some(draw),
                contact: spec.dynamics.contact,
                mesh_damping_ratio: spec.dynamics.mesh_damping_ratio,
                archard: spec.wear.shape == WearShape::Archard,
                transmission_error_um: transmission_error_um.clone(),
                places: places.clone(),
            };
            Ok(Self { member, changes: changes(spec, &cycles)? })
        };
        drawn.specs.iter().map(member).collect()
    }
}

impl Member {
    /// Returns the peak-to-peak transmission error due to wear in µm, by depth.
    pub fn transmission_error_um(&self) -> &[f32] {
        &self.transmission_error_um
    }

    /// Returns the depth at a place of gear `gear` (0 is driving; `None` for the deeper of both) over the
    /// greatest depth, by depth.
    pub fn at_place(&self, gear: Option<usize>, place: FlankPlace) -> Vec<f32> {
        let index = match place {
            FlankPlace::Root => 0,
            FlankPlace::Pitch => 1,
            FlankPlace::Tip => 2,
            FlankPlace::Greatest => 3,
        };
        let of = |gear: usize| &self.places[(gear * 4 + index) * DEPTHS..(gear * 4 + index + 1) * DEPTHS];
        match gear {
            Some(gear) => of(gear.min(1)).to_vec(),
            None => of(0).iter().zip(of(1)).map(|(a, b)| a.max(*b)).collect(),
        }
    }
}

/// Returns the name of a line's feature.
pub(crate) fn line_name(line: usize) -> Name {
    format!("ln_mesh_{}", line + 1).into()
}

/// Relative depths of both gears at the root, the pitch point, the tip and the deepest point.
fn places(pair: &GearPair, worn: &[FlankWear], depths_mm: &[f64]) -> Vec<f32> {
    let mut parts = Vec::with_capacity(8 * DEPTHS);
    for (index, gear) in pair.gears.iter().enumerate() {
        for radius in [Some(gear.sap_radius_mm), Some(gear.pitch_radius_mm), Some(gear.tip_radius_mm), None] {
            // The unworn state takes the shape of the first worn one.
            let states = worn.iter().zip(depths_mm).enumerate();
            parts.extend(states.map(|(i, (wear, depth_mm))| {
                let (wear, depth_mm) = if i == 0 { (&worn[1], &depths_mm[1]) } else { (wear, depth_mm) };
                let at = match radius {
                    Some(radius) => wear.depth_mm(index, radius),
                    None => wear.greatest_depth_mm(pair)[index],
                };
                (at / depth_mm) as f32
            }));
        }
    }
    parts
}

/// Loaded static transmission errors in µm along the line of action: unloaded plus mesh deflection.
fn errors_um(pair: &GearPair, uste_rad: &[f64], stiffness_n_per_m: &[f64]) -> Vec<f64> {
    let [driving, driven] = pair.gears.each_ref().map(|gear| gear.base_radius_mm * 1e-3);
    let force_n = pair.spec.operation.torque_nm / driving;
    let places = uste_rad.iter().zip(stiffness_n_per_m);
    places.map(|(uste, stiffness)| 1e6 * (uste * driven + force_n / stiffness)).collect()
}

/// Peak-to-peak difference of each state's transmission error from the first one's.
fn peak_to_peak_um(errors: &[Vec<f64>]) -> Vec<f64> {
    let peak_to_peak = |errors_um: &Vec<f64>| {
        let added = errors_um.iter().zip(&errors[0]).map(|(worn, new)| worn - new);
        let (low, high) =
            added.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), e| (low.min(e), high.max(e)));
        if high >= low { high - low } else { 0.0 }
    };
    errors.iter().map(peak_to_peak).collect()
}

/// By line and mesh cycle: natural logarithm of the response's amplitude over that of the first cycle.
fn changes(spec: &PairSpec, cycles: &[MeshCycle]) -> Result<Vec<f32>, GearError> {
    let pair = spec.resolve()?;
    let mesh_hz = spec.operation.shaft_speed_hz * f64::from(spec.geometry.teeth[0]);
    let run = RunSettings {
        sample_rate_hz: SAMPLES_A_PERIOD * mesh_hz,
        seconds: PERIODS / mesh_hz,
        ..RunSettings::nominal(&pair, SAMPLES_A_PERIOD * mesh_hz, 1.0)
    };
    let responses = simulate_together(&pair, &cycles.iter().collect::<Vec<_>>(), &run, None)?;
    let amplitudes: Vec<Vec<f64>> = responses.iter().map(|response| log_amplitudes(response)).collect();
    let cells = (0..MESH_LINES).flat_map(|line| amplitudes.iter().map(move |at| (line, at)));
    Ok(cells.map(|(line, at)| (at[line] - amplitudes[0][line]) as f32).collect())
}

/// Natural logarithms of the amplitudes of the mesh harmonics of a response over whole mesh periods.
fn log_amplitudes(response: &[f64]) -> Vec<f64> {
    let amplitude = |line: usize| {
        let step = std::f64::consts::TAU * (line + 1) as f64 / SAMPLES_A_PERIOD;
        let (mut re, mut im) = (0.0, 0.0);
        for (n, value) in response.iter().enumerate() {
            let (sin, cos) = (step * n as f64).sin_cos();
            re += value * cos;
            im += value * sin;
        }
        (2.0 * re.hypot(im) / response.len() as f64).max(MIN_AMPLITUDE).ln()
    };
    (0..MESH_LINES).map(amplitude).collect()
}

/// Interpolates linearly between rising points, constant beyond the ends.
fn interpolated(points: &[f64], values: &[f64], at: f64) -> f64 {
    let upper = points.partition_point(|point| *point <= at);
    if upper == 0 || upper == points.len() {
        return values[upper.saturating_sub(1)];
    }
    let part = (at - points[upper - 1]) / (points[upper] - points[upper - 1]);
    values[upper - 1] + part * (values[upper] - values[upper - 1])
}
