//! Feature curves between the grid's operating points.

use std::collections::BTreeMap;

use super::grid::place;
use super::{GridSettings, LibraryState};
use flankwatch_gear::PairSpec;
use flankwatch_signal::{Features, OperatingPoint};

/// Values over the wear states by feature, of the features that every state has.
pub(super) type FeatureCurves = BTreeMap<String, Vec<f64>>;

/// Returns the curves of a sequence of features.
pub(super) fn curves<'a>(states: impl Iterator<Item = &'a Features> + Clone) -> FeatureCurves {
    let Some(first) = states.clone().next() else {
        return FeatureCurves::new();
    };
    first
        .values
        .keys()
        .filter_map(|name| {
            let curve: Option<Vec<f64>> =
                states.clone().map(|features| features.values.get(name).copied()).collect();
            Some((name.to_string(), curve?))
        })
        .collect()
}

/// Returns the curves of full states.
pub(super) fn state_curves(states: &[LibraryState]) -> FeatureCurves {
    curves(states.iter().map(|state| &state.features))
}

/// Torque and speed of a point over the pair's; 1 where not given.
fn factors(pair: &PairSpec, point: &OperatingPoint) -> [f64; 2] {
    let part = |value: Option<f64>, nominal: f64| value.map_or(1.0, |value| value / nominal);
    let factors = [
        part(point.torque_nm, pair.operation.torque_nm),
        part(point.shaft_speed_hz, pair.operation.shaft_speed_hz),
    ];
    factors.map(|factor| if factor.is_finite() { factor } else { 1.0 })
}

/// Returns the curves at a point, interpolated linearly over torque and speed and constant beyond the grid's
/// ends, of the features that all surrounding grid points have. `tables` has one entry for each torque and,
/// within it, each speed.
pub(super) fn at<'a>(
    grid: &GridSettings,
    pair: &PairSpec,
    tables: &'a [FeatureCurves],
    point: &OperatingPoint,
) -> BTreeMap<&'a str, Vec<f64>> {
    let [torque, speed] = factors(pair, point);
    let (torque_cell, torque_part) = place(&grid.torque_factors, torque);
    let (speed_cell, speed_part) = place(&grid.speed_factors, speed);
    let speeds = grid.speed_factors.len();
    let corner = |torque: usize, speed: usize, weight: f64| {
        let table = tables.get((torque_cell + torque) * speeds + speed_cell + speed);
        table.filter(|_| weight > 0.0).map(|table| (table, weight))
    };
    let corners: Vec<(&FeatureCurves, f64)> = [
        corner(0, 0, (1.0 - torque_part) * (1.0 - speed_part)),
        corner(0, 1, (1.0 - torque_part) * speed_part),
        corner(1, 0, torque_part * (1.0 - speed_part)),
        corner(1, 1, torque_part * speed_part),
    ]
    .into_iter()
    .flatten()
    .collect();
    let Some((first, _)) = corners.first() else {
        return BTreeMap::new();
    };
    first
        .keys()
        .filter_map(|name| {
            let mut sum = vec![0.0; first[name].len()];
            for (table, weight) in &corners {
                let curve = table.get(name)?;
                sum.iter_mut().zip(curve).for_each(|(sum, value)| *sum += weight * value);
            }
            Some((name.as_str(), sum))
        })
        .collect()
}
