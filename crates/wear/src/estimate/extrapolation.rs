//! Records at another speed or torque than the one that wear was simulated at.
//!
//! The members of an ensemble are simulated at the described operating point. A mesh line moves with wear by
//! another amount where the speed has taken it nearer to a resonance, and by another amount under another
//! torque. Near the described point this adds doubt; far from it nothing is claimed.

use crate::library::Ensemble;
use flankwatch_signal::Features;

/// What a member's lines are wrong by far from the speed that they were simulated at: the standard deviation
/// in natural logarithms, ...
const SPEED_DISCREPANCY: f64 = 0.7;

/// ... which is reached over this logarithm of the speed. Both follow from simulating one pair at speeds from
/// half to twice the described one with mesh damping ratios of 0.05 and 0.1: 0.12 at 5 %, 0.2 at 10 %, 0.4 at
/// 25 %, 0.5 to 0.7 at twice the speed.
const SPEED_OVER: f64 = 0.28;

/// Least and greatest speed and torque that wear is told at, in parts of the described ones.
const SPEEDS: [f64; 2] = [0.5, 2.0];
const TORQUES: [f64; 2] = [0.4, 2.5];

/// From these factors on, either way, an answer says that it is less certain.
const CAVEAT_SPEED: f64 = 1.1;
const CAVEAT_TORQUE: f64 = 1.25;

/// A record's speed and torque in parts of the described ones; 1 where one is not known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Extrapolation {
    speed: f64,
    torque: f64,
}

impl Extrapolation {
    /// What a record asks of an ensemble.
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

    /// Why nothing can be said at this operating point.
    pub(super) fn rejection(&self) -> Option<String> {
        let refused = |what, part: f64, [least, most]: [f64; 2]| {
            let inside = (least..=most).contains(&part);
            (!inside).then(|| {
                format!(
                    "not comparable with the simulated wear: the {what} is {part:.2} of the described one, expected {least} to {most} of it"
                )
            })
        };
        refused("shaft speed", self.speed, SPEEDS).or_else(|| refused("torque", self.torque, TORQUES))
    }

    /// The factor on the variance of what a member has wrong, which is `discrepancy` squared far from no wear.
    pub(super) fn variance_factor(&self, discrepancy: f64) -> f64 {
        let wrong = SPEED_DISCREPANCY * (1.0 - (-self.speed.ln().abs() / SPEED_OVER).exp());
        1.0 + (wrong / discrepancy).powi(2)
    }

    /// Why an answer is less certain than at the described operating point.
    pub(super) fn caveat(&self) -> Option<String> {
        let far = |what, part: f64, said: f64| {
            (part.ln().abs() > said.ln()).then(|| format!("the {what} is {part:.2} of the described one"))
        };
        let speed = far("shaft speed", self.speed, CAVEAT_SPEED);
        let torque = far("torque", self.torque, CAVEAT_TORQUE);
        let words: Vec<String> = speed.into_iter().chain(torque).collect();
        (!words.is_empty()).then(|| format!("less certain, as {}", words.join(" and ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn doubt_grows_with_the_distance_to_the_described_point() {
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
                "less certain, as the shaft speed is 0.80 of the described one and the torque is 1.50 of the described one"
            )
        );
        assert!(
            at(0.4, 1.0)
                .rejection()
                .unwrap()
                .contains("the shaft speed is 0.40 of the described one, expected 0.5 to 2")
        );
        assert!(at(1.0, 3.0).rejection().unwrap().contains("the torque is 3.00"));
    }
}
