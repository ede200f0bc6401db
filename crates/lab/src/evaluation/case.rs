//! The cases of the evaluation: wear of the described pair, wear of other pairs, healthy machines and faults.

use super::fault::Fault;
use flankwatch_gear::{ContactRule, PairSpec, WearShape};

/// What the runs of a case test.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Aim {
    /// Wear with the physics of the library.
    OwnPhysics,
    /// Wear with other physics than the library's.
    OtherPhysics,
    /// Neither wear nor fault: no record should be flagged.
    Healthy,
    /// A fault, which should be flagged.
    Fault(Fault),
}

/// Groups of cases.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CaseGroup {
    /// Wear with the library's physics and with others.
    Wear,
    /// Faults and healthy machines.
    Faults,
}

impl Aim {
    /// Returns the group of cases with this aim.
    pub fn group(self) -> CaseGroup {
        match self {
            Self::OwnPhysics | Self::OtherPhysics => CaseGroup::Wear,
            Self::Healthy | Self::Fault(_) => CaseGroup::Faults,
        }
    }
}

/// One case of the evaluation.
#[derive(Debug, Clone)]
pub struct Case {
    /// Name.
    pub name: String,
    /// What it tests.
    pub aim: Aim,
    /// The pair that its runs are simulated with.
    pub pair: PairSpec,
    /// The pair as it is described to the estimator.
    pub described: PairSpec,
}

impl Case {
    /// Returns all cases for a pair, whose library the estimates use.
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
                let wider = pair.geometry.bore_radius_mm().map(|radius| 1.5 * radius);
                pair.geometry.bore_radius_mm = Some(wider);
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
