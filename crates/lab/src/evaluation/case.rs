//! The cases of the evaluation: the library's own physics, others, and what is not wear.

use super::fault::Fault;
use flankwatch_gear::{ContactRule, PairSpec, WearShape};

/// What the runs of a case are to show.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Aim {
    /// Wear of the physics that the library has.
    OwnPhysics,
    /// Wear of another physics.
    OtherPhysics,
    /// No wear and no fault: nothing may be flagged.
    Healthy,
    /// A fault, to be flagged.
    Fault(Fault),
}

/// Cases that are looked at together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CaseGroup {
    /// Wear of the library's own physics and of others.
    Wear,
    /// Faults, and what is healthy.
    Faults,
}

impl Aim {
    /// Which group a case with this aim belongs to.
    pub fn group(self) -> CaseGroup {
        match self {
            Self::OwnPhysics | Self::OtherPhysics => CaseGroup::Wear,
            Self::Healthy | Self::Fault(_) => CaseGroup::Faults,
        }
    }
}

/// One case.
#[derive(Debug, Clone)]
pub struct Case {
    /// In words.
    pub name: String,
    /// What it is to show.
    pub aim: Aim,
    /// The physics of its runs.
    pub pair: PairSpec,
    /// What the estimator is told of the pair.
    pub described: PairSpec,
}

impl Case {
    /// All cases around a pair, whose library the estimates are made with.
    pub fn all(pair: &PairSpec) -> Vec<Self> {
        let other = |name: &str, change: &dyn Fn(&mut PairSpec)| {
            let mut worn = pair.clone();
            change(&mut worn);
            Self { name: name.to_owned(), aim: Aim::OtherPhysics, pair: worn, described: pair.clone() }
        };
        let same = |name: &str, aim| Self {
            name: name.to_owned(),
            aim,
            pair: pair.clone(),
            described: pair.clone(),
        };
        let archard = |ratio: f64| {
            move |pair: &mut PairSpec| {
                pair.wear.shape = WearShape::Archard;
                pair.wear.hardness_pa[1] *= ratio;
            }
        };
        let mut measured = pair.clone();
        measured.wear.measured = true;
        let mut cases = vec![
            Self { described: measured, ..same("own physics, shape known", Aim::OwnPhysics) },
            same("own physics", Aim::OwnPhysics),
            other("Archard, hardness 1:1", &archard(1.0)),
            other("Archard, hardness 1:2", &archard(2.0)),
            other("Archard, hardness 2:1", &archard(0.5)),
            other("mesh damping 0.05", &|pair| pair.dynamics.mesh_damping_ratio = 0.05),
            other("mesh damping 0.1", &|pair| pair.dynamics.mesh_damping_ratio = 0.1),
            other("exponent 2.5 for 4", &|pair| pair.wear.exponent = 2.5),
            other("tip ratio 0.4 for 0.7", &|pair| pair.wear.tip_ratio = 0.4),
            other("floor 0.3 for 0.05", &|pair| pair.wear.floor = 0.3),
            other("mesh damping × ½", &|pair| pair.dynamics.mesh_damping_ratio *= 0.5),
            other("mesh damping × 2", &|pair| pair.dynamics.mesh_damping_ratio *= 2.0),
            other("bore 30 mm for 20", &|pair| {
                pair.geometry.bore_radius_mm = pair.geometry.bore_radius_mm.map(|radius| 1.5 * radius);
            }),
            other("other contact rule", &|pair| {
                pair.dynamics.contact = match pair.dynamics.contact {
                    ContactRule::Loaded => ContactRule::Threshold,
                    ContactRule::Threshold => ContactRule::Loaded,
                };
            }),
            same("healthy", Aim::Healthy),
        ];
        cases.extend(Fault::ALL.map(|fault| same(fault.name(), Aim::Fault(fault))));
        cases
    }
}
