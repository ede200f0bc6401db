//! Mesh lines at another torque than the described one.

use crate::library::DEPTHS;

/// How far lines at another torque are from where they stand at the described one: loads and depths that
/// grow in proportion give responses that do, so a line is read at other depths.
///
/// Those lie a few steps of the depth grid away. A shift is a sum over these steps, of whole rows.
pub(super) struct Load {
    /// A line's changes, between as many zeros.
    changes: [f32; 3 * DEPTHS],
    /// The first step, and the weights of the change so many steps away and of those after it, by depth.
    first: isize,
    weights: Vec<[f32; DEPTHS]>,
}

impl Load {
    /// For a torque as a part of the described one.
    pub(super) fn of(torque: f32, depths_um: &[f32]) -> Self {
        let place = |depth: usize| {
            let um = depths_um[depth] / torque;
            let upper = depths_um.partition_point(|depth| *depth <= um).clamp(1, DEPTHS - 1);
            let part = (um - depths_um[upper - 1]) / (depths_um[upper] - depths_um[upper - 1]);
            (upper as isize - 1 - depth as isize, part.clamp(0.0, 1.0))
        };
        let places: [(isize, f32); DEPTHS] = std::array::from_fn(place);
        let steps = || places.iter().map(|(step, _)| *step).chain([0]);
        let (first, last) = (steps().min().unwrap_or(0), steps().max().unwrap_or(0) + 1);
        let mut weights = vec![[0.0; DEPTHS]; (last - first + 1) as usize];
        for (depth, (step, part)) in places.into_iter().enumerate() {
            let before = (step - first) as usize;
            weights[before][depth] += 1.0 - part;
            weights[before + 1][depth] += part;
            weights[-first as usize][depth] -= 1.0;
        }
        Self { changes: [0.0; 3 * DEPTHS], first, weights }
    }

    /// The shift of a line by depth.
    #[inline(always)]
    pub(super) fn shifts(&mut self, changes: &[f32]) -> [f32; DEPTHS] {
        self.changes[DEPTHS..2 * DEPTHS].copy_from_slice(changes);
        let mut shifts = [0.0; DEPTHS];
        let from = (DEPTHS as isize + self.first) as usize;
        for (weights, away) in self.weights.iter().zip(self.changes[from..].windows(DEPTHS)) {
            for ((shift, weight), away) in shifts.iter_mut().zip(weights).zip(away) {
                *shift += weight * away;
            }
        }
        shifts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_at_another_torque_is_read_at_the_depth_divided_by_it() {
        let depths_um: Vec<f32> = (0..DEPTHS).map(|depth| 0.1 * (depth * depth) as f32).collect();
        let change = |um: f32| (0.005 * um).sin() - 0.3;
        let changes: Vec<f32> = depths_um.iter().map(|um| change(*um)).collect();
        for torque in [0.4, 0.7, 0.98, 1.0, 1.05, 1.6, 2.5] {
            let shifts = Load::of(torque, &depths_um).shifts(&changes);
            for (depth, shift) in shifts.into_iter().enumerate() {
                let um = (depths_um[depth] / torque).min(depths_um[DEPTHS - 1]);
                let expected = change(um) - changes[depth];
                assert!((shift - expected).abs() < 1e-3, "{torque} {depth}: {shift}, expected {expected}");
            }
        }
    }
}
