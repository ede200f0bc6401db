//! Records at a speed or torque other than the one at which wear was simulated.
//!
//! The members of an ensemble are simulated at the described operating point. How far a mesh line moves with
//! wear depends on the torque, and on how near the speed brings the line to a resonance. Near the described
//! point this adds uncertainty; far from it no estimate is made.

use super::comparability::Rejection;
use crate::library::Ensemble;
use flankwatch_signal::Features;

/// Standard deviation, in natural logarithms, of the error of a member's lines far from the simulated speed,
/// ...
const SPEED_DISCREPANCY: f64 = 0.7;

/// ... which is reached over this logarithm of the speed. Both follow from simulating one pair at speeds from
/// half to twice the described one with mesh damping ratios of 0.05 and 0.1: 0.12 at 5 %, 0.2 at 10 %, 0.4 at
/// 25 %, 0.5 to 0.7 at twice the speed.
const SPEED_OVER: f64 = 0.28;

/// Least and greatest speed and torque at which wear is estimated, in parts of the described ones.
const SPEEDS: [f64; 2] = [0.5, 2.0];
const TORQUES: [f64; 2] = [0.4, 2.5];

/// Beyond these factors, either way, an estimate carries a caveat.
const CAVEAT_SPEED: f64 = 1.1;
const CAVEAT_TORQUE: f64 = 1.25;

/// A record's speed and torque in parts of the described ones; 1 where one is not known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Extrapolation {
    speed: f64,
    torque: f64,
}

impl Extrapolation {
    /// Compares a record's operating point with the one that the ensemble is simulated at.
    pub(super) fn of(ensemble: &Ensemble, record: &Features) -> Self {
        let described = &ensemble.described().pair().operation;
        let part = |value: Option<f64>, described: f64| {
            value.filter(|value| *value > 0.0).map_or(1.0, |value| value / described)
        };
        let point = &record.operating_point;
        Self {
            speed: part(point.shaft_speed_hz, described.shaft_speed_hz),
            torque: part(point.torque_nm, described.torque_nm),
        }
    }

    /// Returns why no estimate can be made at this operating point.
    pub(super) fn rejection(&self) -> Option<Rejection> {
        let refused = |what, part: f64, [least, most]: [f64; 2]| {
            let inside = (least..=most).contains(&part);
            (!inside).then(|| Rejection {
                reason: format!(
                    "not comparable with the simulated wear: the {what} is {part:.2} times the described one, expected {least} to {most} times"
                ),
                short: format!("{what} × {part:.2}, × {least} to {most} needed"),
            })
        };
        refused("shaft speed", self.speed, SPEEDS).or_else(|| refused("torque", self.torque, TORQUES))
    }

    /// Returns the factor on the variance of a member's error, whose deviation at deep wear is `discrepancy`.
    pub(super) fn variance_factor(&self, discrepancy: f64) -> f64 {
        let wrong = SPEED_DISCREPANCY * (1.0 - (-self.speed.ln().abs() / SPEED_OVER).exp());
        1.0 + (wrong / discrepancy).powi(2)
    }

    /// Returns why an estimate is less certain than at the described operating point.
    pub(super) fn caveat(&self) -> Option<String> {
        let far = |what, part: f64, least: f64| {
            (part.ln().abs() > least.ln()).then(|| format!("the {what} is {part:.2} times the described one"))
        };
        let speed = far("shaft speed", self.speed, CAVEAT_SPEED);
        let torque = far("torque", self.torque, CAVEAT_TORQUE);
        let reasons: Vec<String> = speed.into_iter().chain(torque).collect();
        (!reasons.is_empty()).then(|| format!("less certain because {}", reasons.join(" and ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uncertainty_grows_with_the_distance_to_the_described_point() {
        let at = |speed, torque| Extrapolation { speed, torque };
        assert_eq!(at(1.0, 1.0).variance_factor(0.45), 1.0);
        assert_eq!((at(1.05, 0.85).caveat(), at(1.0, 1.0).rejection()), (None, None));
        // As simulated: 0.20 in the logarithm at 10 %, 0.38 at 25 %.
        for (speed, simulated) in [(1.1, 0.2), (1.0 / 1.25, 0.38), (2.0, 0.64)] {
            let wrong = (at(speed, 1.0).variance_factor(1.0) - 1.0).sqrt();
            assert!((wrong - simulated).abs() < 0.02, "{speed}: {wrong}");
        }
        assert_eq!(
            at(0.8, 1.5).caveat().as_deref(),
            Some(
                "less certain because the shaft speed is 0.80 times the described one and the torque is 1.50 times the described one"
            )
        );
        assert!(
            at(0.4, 1.0)
                .rejection()
                .unwrap()
                .reason
                .contains("the shaft speed is 0.40 times the described one, expected 0.5 to 2 times")
        );
        assert!(at(1.0, 3.0).rejection().unwrap().reason.contains("the torque is 3.00"));
        assert_eq!(at(1.0, 3.0).rejection().unwrap().short, "torque × 3.00, × 0.4 to 2.5 needed");
    }
}
