//! Mesh lines at a torque other than the described one.

use crate::library::DEPTHS;

/// Depths at which lines are read at another torque. If load and depth grow in proportion, so does the
/// response; a line at relative torque τ and depth h therefore changes as at depth h/τ.
pub(super) struct Load {
    /// By depth: index of the grid depth below the one that is read, and the fraction of the way to the next.
    places: [(usize, f32); DEPTHS],
}

impl Load {
    /// Creates the mapping for a torque in parts of the described one.
    pub(super) fn of(torque: f32, depths_um: &[f32]) -> Self {
        let place = |depth: usize| {
            let um = depths_um[depth] / torque;
            let upper = depths_um.partition_point(|depth| *depth <= um).clamp(1, DEPTHS - 1);
            let part = (um - depths_um[upper - 1]) / (depths_um[upper] - depths_um[upper - 1]);
            (upper - 1, part.clamp(0.0, 1.0))
        };
        Self { places: std::array::from_fn(place) }
    }

    /// Returns where a line is read for a grid depth: index below, and fraction of the way to the next.
    #[inline(always)]
    pub(super) fn place(&self, depth: usize) -> (usize, f32) {
        self.places[depth]
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
            let load = Load::of(torque, &depths_um);
            for depth in 0..DEPTHS {
                let (lower, part) = load.place(depth);
                let read = changes[lower] + part * (changes[lower + 1] - changes[lower]);
                let expected = change((depths_um[depth] / torque).min(depths_um[DEPTHS - 1]));
                assert!((read - expected).abs() < 1e-3, "{torque} {depth}: {read}, expected {expected}");
            }
        }
    }
}
