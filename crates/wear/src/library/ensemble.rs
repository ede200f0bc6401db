//! A library with its neighbours: the same pair under the other contact rule, and both at other torques and speeds.
//!
//! One library answers what wear of the described shape does to the described pair. Which contact rule a real pair follows is not known
//! beforehand, and the rules differ in everything; so the estimate compares records with both and lets them decide. Other damping, bodies and shapes of
//! wear change the lines less than depth does, and are not simulated.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::file::hex;
use super::{BuildControl, GridSettings, Library, LibraryError, LibraryState, build};
use flankwatch_gear::{ContactRule, PairSpec};

/// Which neighbours are simulated, and how.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EnsembleSettings {
    /// Whether the pair is simulated under the other contact rule too.
    pub other_rule: bool,
    /// Length of each simulated record in seconds.
    pub seconds: f64,
    /// Whether other torques and speeds are simulated.
    pub operating_points: bool,
}

impl Default for EnsembleSettings {
    fn default() -> Self {
        Self {
            other_rule: true,
            seconds: 1.0,
            operating_points: true,
        }
    }
}

impl EnsembleSettings {
    /// The pair of a library and no other.
    pub fn described_alone() -> Self {
        Self {
            other_rule: false,
            operating_points: false,
            ..Self::default()
        }
    }

    /// How many physics are simulated.
    pub fn libraries(&self) -> usize {
        let points = if self.operating_points {
            TORQUE_PARTS.len() + SPEED_PARTS.len()
        } else {
            0
        };
        (1 + usize::from(self.other_rule)) * (1 + points)
    }
}

/// Depths up to here in µm change the vibration fast, because wear of the size of the teeth's deflection acts as a tip relief; the grid
/// there is finer.
const FINE_UP_TO_UM: f64 = 30.0;
const FINE_STATES: usize = 31;
const COARSE_STATES: usize = 50;

/// Parts of the described torque and speed that the described pair is simulated at besides 1.
const TORQUE_PARTS: [f64; 6] = [0.6, 0.8, 0.9, 0.95, 1.05, 1.15];
const SPEED_PARTS: [f64; 2] = [0.92, 1.08];

/// Prior probability of the rule that the pair is described with.
const DESCRIBED: f64 = 0.7;

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
            let value = |state: &&LibraryState| {
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

/// One physics at the described operating point and around it.
#[derive(Debug, Clone)]
pub struct Member {
    curves: MemberCurves,
    torques: Vec<(f64, MemberCurves)>,
    speeds: Vec<(f64, MemberCurves)>,
}

impl Member {
    /// Feature curves at the described torque and speed.
    pub fn curves(&self) -> &MemberCurves {
        &self.curves
    }

    /// Operating points besides the described one.
    pub fn operating_points(&self) -> usize {
        self.torques.len() + self.speeds.len()
    }

    /// How far a feature moves at this depth from the described torque and speed to an operating point's.
    pub fn operating_shift(&self, point: usize, name: &str, wear_um: f64) -> f64 {
        let curves = self.torques.iter().chain(&self.speeds).nth(point).map(|(_, curves)| curves);
        let shift = |curves: &MemberCurves| Some(curves.at(name, wear_um)? - self.curves.at(name, wear_um)?);
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

/// The described pair and the same pair under the other contact rule.
#[derive(Debug, Clone)]
pub struct Ensemble {
    id: String,
    described: Arc<Library>,
    members: Vec<Member>,
}

/// Where the library of a pair on a grid comes from.
pub type LibrarySource<'a> = dyn Fn(&PairSpec, &GridSettings) -> Result<Arc<Library>, LibraryError> + 'a;

#[derive(Clone, Copy)]
enum Axis {
    Torque,
    Speed,
}

/// Parts of torque or speed that a member is simulated at besides 1.
fn points() -> impl Iterator<Item = (Axis, f64)> {
    let torques = TORQUE_PARTS.into_iter().map(|part| (Axis::Torque, part));
    torques.chain(SPEED_PARTS.into_iter().map(|part| (Axis::Speed, part)))
}

impl Ensemble {
    /// A library without neighbours.
    pub fn of(library: Arc<Library>) -> Self {
        Self {
            id: library.id().to_owned(),
            members: vec![Member {
                curves: MemberCurves::of(std::slice::from_ref(&library)),
                torques: Vec::new(),
                speeds: Vec::new(),
            }],
            described: library,
        }
    }

    /// Simulates the neighbours of a library, each asked of `get` (a shelf, or [`build`] itself); `progress` is called with the libraries
    /// done and their number.
    ///
    /// # Errors
    /// Those of `get` for the described pair; the other rule, or an operating point, that cannot be simulated is left out.
    pub fn around(
        library: Arc<Library>,
        settings: &EnsembleSettings,
        get: &LibrarySource<'_>,
        progress: &dyn Fn(usize, usize),
    ) -> Result<Self, LibraryError> {
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
        // A library that is fine by itself needs no finer grid.
        let grids = if library.max_wear_um() > 2.0 * FINE_UP_TO_UM {
            vec![fine, coarse]
        } else {
            vec![coarse]
        };
        let total = settings.libraries();
        let mut done = 0;
        let mut ids = vec![library.id().to_owned()];
        let mut curves = |pair: &PairSpec| -> Result<MemberCurves, LibraryError> {
            let built = grids.iter().map(|grid| get(pair, grid)).collect::<Result<Vec<_>, _>>();
            done += 1;
            progress(done, total);
            let built = built?;
            ids.extend(built.iter().map(|library| library.id().to_owned()));
            Ok(MemberCurves::of(&built))
        };
        let mut pairs = vec![library.pair().clone()];
        if settings.other_rule {
            pairs.push(under_other_rule(library.pair()));
        }
        let mut members: Vec<Member> = Vec::new();
        for pair in &pairs {
            let mut member = match curves(pair) {
                Ok(curves) => Member {
                    curves,
                    torques: Vec::new(),
                    speeds: Vec::new(),
                },
                Err(error) if members.is_empty() => return Err(error),
                Err(_) => continue,
            };
            for (axis, part) in points().filter(|_| settings.operating_points) {
                let (pair, points) = match axis {
                    Axis::Torque => (at_torque(pair, part), &mut member.torques),
                    Axis::Speed => (at_speed(pair, part), &mut member.speeds),
                };
                if let Ok(curves) = curves(&pair) {
                    points.push((part, curves));
                }
            }
            members.push(member);
        }
        Ok(Self {
            id: hex(ids.join(" ").as_bytes())[..16].to_owned(),
            described: library,
            members,
        })
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

    /// The described pair, and after it what else it may be.
    pub fn members(&self) -> &[Member] {
        &self.members
    }

    /// Prior probability of a member.
    pub fn prior(&self, member: usize) -> f64 {
        match (member, self.members.len() - 1) {
            (_, 0) => 1.0,
            (0, _) => DESCRIBED,
            (_, others) => (1.0 - DESCRIBED) / others as f64,
        }
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

fn at_torque(pair: &PairSpec, part: f64) -> PairSpec {
    let mut other = pair.clone();
    other.operation.torque_nm *= part;
    other.operation.output_torque_nm = other.operation.output_torque_nm.map(|torque| torque * part);
    other
}

fn at_speed(pair: &PairSpec, part: f64) -> PairSpec {
    let mut other = pair.clone();
    other.operation.shaft_speed_hz *= part;
    other
}

fn under_other_rule(pair: &PairSpec) -> PairSpec {
    let mut other = pair.clone();
    other.dynamics.contact = match other.dynamics.contact {
        ContactRule::Loaded => ContactRule::Threshold,
        ContactRule::Threshold => ContactRule::Loaded,
    };
    other
}
