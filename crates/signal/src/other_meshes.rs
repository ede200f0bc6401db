//! Other meshes that the same sensor hears: where their lines lie among those of the mesh that is looked at.
//!
//! All shafts of a gearbox are tied to each other by tooth numbers, so that a line of another mesh has a
//! fixed order of this mesh's driving shaft. Its harmonics and their sidebands say nothing of this mesh, and
//! are no sign of a bearing.

/// The most other meshes that are known of.
const MOST: usize = 14;

/// What belongs to another mesh's harmonic, in rates of its faster shaft, as for the own harmonics.
const COMB_SHAFTS: f64 = 3.5;

/// One other mesh, in orders: turns and tooth meshes for each turn of the driving shaft of the mesh that is
/// looked at.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct OtherMesh {
    /// Tooth meshes.
    pub mesh_orders: f64,
    /// Turns of its driving and its driven shaft.
    pub shaft_orders: [f64; 2],
}

/// The other meshes of a sensor; without any nothing is left out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OtherMeshes {
    meshes: [Option<OtherMesh>; MOST],
}

impl OtherMeshes {
    /// No other mesh.
    pub const NONE: Self = Self { meshes: [None; MOST] };

    /// These meshes: the first 14, and of those the ones whose numbers are above zero and finite.
    pub fn of(all: impl IntoIterator<Item = OtherMesh>) -> Self {
        let mut this = Self::NONE;
        let usable = |mesh: &OtherMesh| {
            let [driving, driven] = mesh.shaft_orders;
            [mesh.mesh_orders, driving, driven].iter().all(|order| *order > 0.0 && order.is_finite())
        };
        for (place, mesh) in this.meshes.iter_mut().zip(all.into_iter().filter(usable)) {
            *place = Some(mesh);
        }
        this
    }

    /// The same meshes in orders of a shaft that makes this many `turns` while the one they are given for
    /// makes one.
    pub(super) fn for_each_turn_of(&self, turns: f64) -> Self {
        Self::of(self.iter().map(|mesh| OtherMesh {
            mesh_orders: mesh.mesh_orders / turns,
            shaft_orders: mesh.shaft_orders.map(|order| order / turns),
        }))
    }

    /// Whether there are any.
    pub(super) fn is_empty(&self) -> bool {
        self.meshes[0].is_none()
    }

    fn iter(&self) -> impl Iterator<Item = &OtherMesh> {
        self.meshes.iter().flatten()
    }

    /// Whether a harmonic of another mesh, or a first sideband of one at the rate of either of its shafts,
    /// lies within `reach` of an order.
    pub(super) fn lie_at(&self, order: f64, reach: f64) -> bool {
        self.iter().any(|mesh| {
            let [driving, driven] = mesh.shaft_orders;
            [0.0, driving, -driving, driven, -driven].iter().any(|beside| {
                let harmonic = ((order - beside) / mesh.mesh_orders).round().max(1.0);
                (harmonic * mesh.mesh_orders + beside - order).abs() <= reach
            })
        })
    }

    /// The shafts' rates in orders of the described mesh's driving shaft.
    pub(super) fn shaft_orders(&self) -> impl Iterator<Item = f64> {
        self.iter().flat_map(|mesh| mesh.shaft_orders)
    }

    /// The orders up to `highest` of harmonics and of their first two sidebands at the rates of both shafts.
    pub(super) fn lines_up_to(&self, highest: f64) -> Vec<f64> {
        let mut lines = Vec::new();
        for mesh in self.iter() {
            let [driving, driven] = mesh.shaft_orders;
            let beside = [0.0, driving, driven, 2.0 * driving, 2.0 * driven].map(|beside| [beside, -beside]);
            let harmonics = (1..).map(|harmonic| f64::from(harmonic) * mesh.mesh_orders);
            for harmonic in harmonics.take_while(|harmonic| *harmonic <= highest) {
                lines.extend(beside.as_flattened().iter().map(|beside| harmonic + beside));
            }
        }
        lines.retain(|line| (0.0..=highest).contains(line));
        lines.sort_unstable_by(f64::total_cmp);
        lines.dedup_by(|one, other| (*one - *other).abs() < 1e-9);
        lines
    }

    /// Whether an order belongs to a harmonic of another mesh: within 3½ rates of its faster shaft and this
    /// part of its own order.
    pub(super) fn hold(&self, order: f64, wander: f64) -> bool {
        self.iter().any(|mesh| {
            let harmonic = (order / mesh.mesh_orders).round().max(1.0) * mesh.mesh_orders;
            let [driving, driven] = mesh.shaft_orders;
            (harmonic - order).abs() <= COMB_SHAFTS * driving.max(driven) + wander * harmonic
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The second stage, 19 teeth on the shaft that the first one's 24 teeth drive through 36.
    fn second_stage() -> OtherMeshes {
        let shaft = 24.0 / 36.0;
        OtherMeshes::of([OtherMesh { mesh_orders: 19.0 * shaft, shaft_orders: [shaft, shaft * 19.0 / 57.0] }])
    }

    #[test]
    fn harmonics_and_their_first_sidebands_lie_where_the_teeth_put_them() {
        let others = second_stage();
        let mesh = 19.0 * 24.0 / 36.0;
        for order in [mesh, 3.0 * mesh, 2.0 * mesh + 24.0 / 36.0, mesh - 24.0 / 36.0 / 3.0] {
            assert!(others.lie_at(order, 1e-6), "{order}");
        }
        for order in [24.0, 48.0, 0.5 * mesh, 2.0 * mesh + 1.0] {
            assert!(!others.lie_at(order, 0.05), "{order}");
        }
        // 17 × 19 + 1 = 9 × 36.
        assert!(others.lie_at(9.0 * 24.0, 1e-6));
        let lines = others.lines_up_to(2.5 * mesh);
        assert!(lines.len() == 18 && lines.is_sorted() && lines.contains(&mesh), "{lines:?}");
        assert!(others.hold(mesh + 2.0, 0.0) && !others.hold(mesh + 2.5, 0.0));
    }

    #[test]
    fn nothing_lies_where_no_other_mesh_is_known() {
        assert!(
            OtherMeshes::NONE.is_empty()
                && !OtherMeshes::NONE.lie_at(24.0, 100.0)
                && !OtherMeshes::NONE.hold(24.0, 1.0)
        );
        let unusable = OtherMesh { mesh_orders: f64::NAN, shaft_orders: [1.0, 1.0] };
        assert!(OtherMeshes::of([unusable, OtherMesh::default()]).is_empty());
        assert!(!second_stage().is_empty());
    }
}
