//! A library with its neighbours: the same pair under other assumptions where its description may be wrong, and at other loads and speeds.
//!
//! One library answers what wear of the described shape does to the described pair. Nobody knows a real pair that well, so the estimate
//! compares records with an ensemble: the described pair first, then variants of it with another wear shape, damping, bore or
//! contact rule, drawn as a Latin hypercube. How far they differ is what the library may be wrong by.

use std::collections::BTreeMap;
use std::sync::Arc;

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::file::hex;
use super::{BuildControl, GridSettings, Library, LibraryError, build};
use crate::gear::{ContactRule, PairSpec, WearShape};

/// Which neighbours are simulated, and how.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EnsembleSettings {
    /// Variants of the pair besides the one described.
    pub variants: usize,
    /// Length of each of their simulated records in seconds.
    pub seconds: f64,
    /// Whether the described pair is simulated at other torques and speeds too.
    pub operating_points: bool,
    /// Seed of the Latin hypercube.
    pub seed: u64,
}

impl Default for EnsembleSettings {
    fn default() -> Self {
        Self {
            variants: 14,
            seconds: 1.0,
            operating_points: true,
            seed: 1,
        }
    }
}

impl EnsembleSettings {
    /// How many physics are simulated.
    pub fn libraries(&self) -> usize {
        let points = if self.operating_points {
            TORQUE_PARTS.len() + SPEED_PARTS.len()
        } else {
            0
        };
        1 + points + self.variants
    }
}

/// Depths up to here in µm change the vibration fast, because wear of the size of the teeth's deflection acts as a tip relief; the grid
/// there is finer.
const FINE_UP_TO_UM: f64 = 30.0;
const FINE_STATES: usize = 13;
const COARSE_STATES: usize = 26;

/// Parts of the described torque and speed that the described pair is simulated at besides 1.
const TORQUE_PARTS: [f64; 3] = [0.6, 0.85, 1.15];
const SPEED_PARTS: [f64; 2] = [0.92, 1.08];

/// Prior probability of the pair as it is described; the variants share the rest.
const DESCRIBED: f64 = 0.9;

/// How far the variants reach: factors on exponent, tip ratio, damping and bore, the floor itself, and the part of them with the other rule.
const EXPONENT: [f64; 2] = [0.5, 1.6];
const TIP_RATIO: [f64; 2] = [0.5, 1.4];
const FLOOR: [f64; 2] = [0.0, 0.36];
const DAMPING: [f64; 2] = [0.45, 2.2];
const BORE: [f64; 2] = [0.8, 1.6];
const OTHER_RULE: f64 = 0.25;

/// Feature curves of one physics over wear depth.
#[derive(Debug, Clone, PartialEq)]
pub struct MemberCurves {
    depths_um: Vec<f64>,
    curves: BTreeMap<String, Vec<f64>>,
}

impl MemberCurves {
    /// The curves of libraries of one pair on different grids, together.
    fn of(libraries: &[Arc<Library>]) -> Self {
        let mut states: Vec<_> = libraries.iter().flat_map(|library| library.states()).collect();
        states.sort_by(|a, b| a.wear_um.total_cmp(&b.wear_um));
        states.dedup_by(|a, b| (a.wear_um - b.wear_um).abs() < 1e-9);
        let depths_um = states.iter().map(|state| state.wear_um).collect();
        let all = |name: &String| -> Option<Vec<f64>> {
            let value = |state: &&super::LibraryState| {
                let features = &state.features;
                features.values.get(name).or_else(|| features.checks.get(name)).copied()
            };
            states.iter().map(value).collect()
        };
        let names = states.first().into_iter();
        let names = names.flat_map(|state| state.features.values.keys().chain(state.features.checks.keys()));
        let curves = names.filter_map(|name| Some((name.clone(), all(name)?))).collect();
        Self { depths_um, curves }
    }

    /// Whether there is a curve of this feature.
    pub fn has(&self, name: &str) -> bool {
        self.curves.contains_key(name)
    }

    /// A feature at a depth in µm, linear between states and held at the ends.
    pub fn at(&self, name: &str, wear_um: f64) -> Option<f64> {
        let curve = self.curves.get(name)?;
        let depths = &self.depths_um;
        let upper = depths.partition_point(|&depth| depth <= wear_um);
        if upper == 0 {
            return curve.first().copied();
        }
        if upper == depths.len() {
            return curve.last().copied();
        }
        let part = (wear_um - depths[upper - 1]) / (depths[upper] - depths[upper - 1]);
        Some(curve[upper - 1] + part * (curve[upper] - curve[upper - 1]))
    }

    /// How far a feature has moved from unworn at a depth in µm.
    pub fn change(&self, name: &str, wear_um: f64) -> Option<f64> {
        Some(self.at(name, wear_um)? - self.at(name, 0.0)?)
    }
}

/// The described pair, its variants, and the described pair at other operating points.
#[derive(Debug, Clone)]
pub struct Ensemble {
    id: String,
    described: Arc<Library>,
    members: Vec<MemberCurves>,
    torques: Vec<(f64, MemberCurves)>,
    speeds: Vec<(f64, MemberCurves)>,
}

/// Where the library of a pair on a grid comes from.
pub type LibrarySource<'a> = dyn Fn(&PairSpec, &GridSettings) -> Result<Arc<Library>, LibraryError> + 'a;

/// One library that an ensemble is made of.
struct Part {
    pair: PairSpec,
    role: Role,
}

#[derive(Clone, Copy)]
enum Role {
    Described,
    Variant,
    Torque(f64),
    Speed(f64),
}

impl Ensemble {
    /// A library without neighbours.
    pub fn of(library: Arc<Library>) -> Self {
        Self {
            id: library.id().to_owned(),
            members: vec![MemberCurves::of(std::slice::from_ref(&library))],
            described: library,
            torques: Vec::new(),
            speeds: Vec::new(),
        }
    }

    /// Simulates the neighbours of a library, each asked of `get` (a shelf, or [`build`] itself); `progress` is called with the libraries
    /// done and their number.
    ///
    /// # Errors
    /// Those of `get` for the described pair; a variant that cannot be simulated is left out.
    pub fn around(
        library: Arc<Library>,
        settings: &EnsembleSettings,
        get: &LibrarySource<'_>,
        progress: &dyn Fn(usize, usize),
    ) -> Result<Self, LibraryError> {
        let max_wear_um = library.max_wear_um();
        let base = GridSettings {
            seconds: settings.seconds,
            torque_factors: vec![1.0],
            speed_factors: vec![1.0],
            ..library.manifest().grid.clone()
        };
        let fine = GridSettings {
            states: FINE_STATES,
            max_wear_um: FINE_UP_TO_UM,
            ..base.clone()
        };
        let coarse = GridSettings {
            states: COARSE_STATES,
            ..base
        };
        let parts = parts(library.pair(), settings);
        let total = parts.len();
        let mut ensemble = Self::of(Arc::clone(&library));
        let mut ids = vec![library.id().to_owned()];
        for (done, part) in parts.into_iter().enumerate() {
            let grids = [&fine, &coarse];
            // A library that is fine by itself needs no finer grid.
            let grids = if max_wear_um > 2.0 * FINE_UP_TO_UM {
                &grids[..]
            } else {
                &grids[1..]
            };
            let built: Result<Vec<_>, _> = grids.iter().map(|grid| get(&part.pair, grid)).collect();
            progress(done + 1, total);
            let built = match (built, part.role) {
                (Ok(built), _) => built,
                (Err(error), Role::Described) => return Err(error),
                // A variant that the mechanics refuse is no possible pair.
                (Err(_), _) => continue,
            };
            ids.extend(built.iter().map(|library| library.id().to_owned()));
            match part.role {
                // Records of the same length as the variants': what noise adds to a weak line depends on it.
                Role::Described => ensemble.members[0] = MemberCurves::of(&built),
                Role::Variant => ensemble.members.push(MemberCurves::of(&built)),
                Role::Torque(part) => ensemble.torques.push((part, MemberCurves::of(&built))),
                Role::Speed(part) => ensemble.speeds.push((part, MemberCurves::of(&built))),
            }
        }
        ensemble.id = hex(ids.join(" ").as_bytes())[..16].to_owned();
        Ok(ensemble)
    }

    /// Simulates everything in memory.
    ///
    /// # Errors
    /// Those of [`build`].
    pub fn build(
        pair: &PairSpec,
        grid: &GridSettings,
        settings: &EnsembleSettings,
        progress: &dyn Fn(usize, usize),
    ) -> Result<Self, LibraryError> {
        let get = |pair: &PairSpec, grid: &GridSettings| build(pair, grid, &BuildControl::silent()).map(Arc::new);
        Self::around(get(pair, grid)?, settings, &get, progress)
    }

    /// Hash of all libraries in it.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// The library of the pair as it is described.
    pub fn described(&self) -> &Arc<Library> {
        &self.described
    }

    /// Feature curves of the described pair and of each variant.
    pub fn members(&self) -> &[MemberCurves] {
        &self.members
    }

    /// Prior probability of a member.
    pub fn prior(&self, member: usize) -> f64 {
        let variants = self.members.len() - 1;
        match (member, variants) {
            (_, 0) => 1.0,
            (0, _) => DESCRIBED,
            _ => (1.0 - DESCRIBED) / variants as f64,
        }
    }

    /// Operating points besides the described one.
    pub fn operating_points(&self) -> usize {
        self.torques.len() + self.speeds.len()
    }

    /// How far a feature of the described pair moves at this depth from the described torque and speed to an operating point's.
    pub fn operating_shift(&self, point: usize, name: &str, wear_um: f64) -> f64 {
        let curves = self.torques.iter().chain(&self.speeds).nth(point).map(|(_, curves)| curves);
        let shift = |curves: &MemberCurves| Some(curves.at(name, wear_um)? - self.members[0].at(name, wear_um)?);
        curves.and_then(shift).unwrap_or(0.0)
    }

    /// With what weight each operating point's shift counts at these parts of the described torque and speed: the shift is linear in the
    /// logarithm between points, held at the ends, and the two axes add.
    pub fn operating_weights(&self, torque_part: f64, speed_part: f64) -> Vec<f64> {
        let mut weights = along(&self.torques, torque_part);
        weights.extend(along(&self.speeds, speed_part));
        weights
    }
}

/// Weights of the points of one axis, the described point at 1 among them.
fn along(points: &[(f64, MemberCurves)], part: f64) -> Vec<f64> {
    let mut weights = vec![0.0; points.len()];
    let places = points
        .iter()
        .map(|(place, _)| place.ln())
        .enumerate()
        .map(|(i, place)| (place, Some(i)));
    let mut places: Vec<(f64, Option<usize>)> = places.chain([(0.0, None)]).collect();
    places.sort_by(|a, b| a.0.total_cmp(&b.0));
    let x = part.ln().clamp(places[0].0, places[places.len() - 1].0);
    let mut add = |point: Option<usize>, weight: f64| {
        if let Some(point) = point {
            weights[point] += weight;
        }
    };
    let upper = places.partition_point(|place| place.0 <= x);
    if upper == places.len() {
        add(places[upper - 1].1, 1.0);
    } else {
        let share = (x - places[upper - 1].0) / (places[upper].0 - places[upper - 1].0);
        add(places[upper - 1].1, 1.0 - share);
        add(places[upper].1, share);
    }
    weights
}

fn parts(pair: &PairSpec, settings: &EnsembleSettings) -> Vec<Part> {
    let mut parts = vec![Part {
        pair: pair.clone(),
        role: Role::Described,
    }];
    if settings.operating_points {
        for part in TORQUE_PARTS {
            let mut other = pair.clone();
            other.operation.torque_nm *= part;
            other.operation.output_torque_nm = other.operation.output_torque_nm.map(|torque| torque * part);
            parts.push(Part {
                pair: other,
                role: Role::Torque(part),
            });
        }
        for part in SPEED_PARTS {
            let mut other = pair.clone();
            other.operation.shaft_speed_hz *= part;
            parts.push(Part {
                pair: other,
                role: Role::Speed(part),
            });
        }
    }
    parts.extend(variants(pair, settings).into_iter().map(|pair| Part { pair, role: Role::Variant }));
    parts
}

/// Variants of a pair as a Latin hypercube: each quantity takes each of its strata once, in an order of its own.
fn variants(pair: &PairSpec, settings: &EnsembleSettings) -> Vec<PairSpec> {
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    let count = settings.variants;
    let mut strata = || -> Vec<f64> {
        let mut places: Vec<f64> = (0..count).map(|i| (i as f64 + rng.random::<f64>()) / count as f64).collect();
        places.shuffle(&mut rng);
        places
    };
    let [exponent, tip, floor, damping, bore, rule]: [Vec<f64>; 6] = std::array::from_fn(|_| strata());
    let by_factor = |[low, high]: [f64; 2], place: f64| low * (high / low).powf(place);
    (0..count)
        .map(|i| {
            let mut other = pair.clone();
            // A table or Archard's law is kept in every second variant; the others have the parabolic shape.
            if other.wear.shape == WearShape::Parabolic || i % 2 == 1 {
                other.wear.shape = WearShape::Parabolic;
                other.wear.exponent = (other.wear.exponent * by_factor(EXPONENT, exponent[i])).max(1.5);
                other.wear.tip_ratio = (other.wear.tip_ratio * by_factor(TIP_RATIO, tip[i])).clamp(0.05, 1.0);
                other.wear.floor = (FLOOR[0] + (FLOOR[1] - FLOOR[0]) * floor[i]).min(other.wear.tip_ratio);
            }
            other.dynamics.mesh_damping_ratio *= by_factor(DAMPING, damping[i]);
            let factor = by_factor(BORE, bore[i]);
            other.geometry.bore_radius_mm = other.geometry.bore_radius_mm.map(|radius| radius * factor);
            if rule[i] < OTHER_RULE {
                other.dynamics.contact = match other.dynamics.contact {
                    ContactRule::Loaded => ContactRule::Threshold,
                    ContactRule::Threshold => ContactRule::Loaded,
                };
            }
            other
        })
        .collect()
}
