//! Other meshes that the same sensor measures: the positions of their lines relative to those of the mesh
//! under analysis.
//!
//! All shafts of a gearbox are coupled by tooth counts, so a line of another mesh has a fixed order of this
//! mesh's driving shaft. Its harmonics and sidebands carry no information on this mesh and are no sign of a
//! bearing fault.

/// Largest number of other meshes.
const MAX_MESHES: usize = 14;

/// Half-width of another mesh's harmonic with its sidebands, in rates of its faster shaft, as for this mesh's
/// harmonics.
const COMB_SHAFTS: f64 = 3.5;

/// One other mesh, in orders: tooth meshes and turns per turn of the driving shaft of the mesh under
/// analysis.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct OtherMesh {
    /// Mesh frequency in orders.
    pub mesh_orders: f64,
    /// Rotational frequencies of its driving and its driven shaft in orders.
    pub shaft_orders: [f64; 2],
}

/// The other meshes of a sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OtherMeshes {
    meshes: [Option<OtherMesh>; MAX_MESHES],
}

impl OtherMeshes {
    /// No other mesh.
    pub const NONE: Self = Self { meshes: [None; MAX_MESHES] };

    /// Collects the first 14 meshes whose numbers are positive and finite.
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

    /// Refers the meshes to a shaft that makes this many `turns` per turn of the current reference shaft.
    pub(super) fn referred_to_shaft(&self, turns: f64) -> Self {
        Self::of(self.iter().map(|mesh| OtherMesh {
            mesh_orders: mesh.mesh_orders / turns,
            shaft_orders: mesh.shaft_orders.map(|order| order / turns),
        }))
    }

    /// Returns whether there are no other meshes.
    pub(super) fn is_empty(&self) -> bool {
        self.meshes[0].is_none()
    }

    fn iter(&self) -> impl Iterator<Item = &OtherMesh> {
        self.meshes.iter().flatten()
    }

    /// Returns whether a harmonic of another mesh, or a first sideband of one at the rate of either of its
    /// shafts, lies within `reach` of an order.
    pub(super) fn has_line_near(&self, order: f64, reach: f64) -> bool {
        self.iter().any(|mesh| {
            let [driving, driven] = mesh.shaft_orders;
            [0.0, driving, -driving, driven, -driven].iter().any(|offset| {
                let harmonic = ((order - offset) / mesh.mesh_orders).round().max(1.0);
                (harmonic * mesh.mesh_orders + offset - order).abs() <= reach
            })
        })
    }

    /// Returns the shaft rates in orders of the driving shaft of the mesh under analysis.
    pub(super) fn shaft_orders(&self) -> impl Iterator<Item = f64> {
        self.iter().flat_map(|mesh| mesh.shaft_orders)
    }

    /// Returns the orders up to `highest` of the harmonics and of their first two sidebands at the rates of
    /// both shafts.
    pub(super) fn lines_up_to(&self, highest: f64) -> Vec<f64> {
        let mut lines = Vec::new();
        for mesh in self.iter() {
            let [driving, driven] = mesh.shaft_orders;
            let offset = [0.0, driving, driven, 2.0 * driving, 2.0 * driven].map(|offset| [offset, -offset]);
            let harmonics = (1..).map(|harmonic| f64::from(harmonic) * mesh.mesh_orders);
            for harmonic in harmonics.take_while(|harmonic| *harmonic <= highest) {
                lines.extend(offset.as_flattened().iter().map(|offset| harmonic + offset));
            }
        }
        lines.retain(|line| (0.0..=highest).contains(line));
        lines.sort_unstable_by(f64::total_cmp);
        lines.dedup_by(|one, other| (*one - *other).abs() < 1e-9);
        lines
    }

    /// Returns whether an order belongs to a harmonic of another mesh: within 3½ rates of its faster shaft
    /// plus a `tolerance` as a fraction of the harmonic's order.
    pub(super) fn contains(&self, order: f64, tolerance: f64) -> bool {
        self.iter().any(|mesh| {
            let harmonic = (order / mesh.mesh_orders).round().max(1.0) * mesh.mesh_orders;
            let [driving, driven] = mesh.shaft_orders;
            (harmonic - order).abs() <= COMB_SHAFTS * driving.max(driven) + tolerance * harmonic
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
    fn harmonics_and_first_sidebands_follow_the_tooth_numbers() {
        let others = second_stage();
        let mesh = 19.0 * 24.0 / 36.0;
        for order in [mesh, 3.0 * mesh, 2.0 * mesh + 24.0 / 36.0, mesh - 24.0 / 36.0 / 3.0] {
            assert!(others.has_line_near(order, 1e-6), "{order}");
        }
        for order in [24.0, 48.0, 0.5 * mesh, 2.0 * mesh + 1.0] {
            assert!(!others.has_line_near(order, 0.05), "{order}");
        }
        // 17 × 19 + 1 = 9 × 36.
        assert!(others.has_line_near(9.0 * 24.0, 1e-6));
        let lines = others.lines_up_to(2.5 * mesh);
        assert!(lines.len() == 18 && lines.is_sorted() && lines.contains(&mesh), "{lines:?}");
        assert!(others.contains(mesh + 2.0, 0.0) && !others.contains(mesh + 2.5, 0.0));
    }

    #[test]
    fn no_lines_without_other_meshes() {
        assert!(
            OtherMeshes::NONE.is_empty()
                && !OtherMeshes::NONE.has_line_near(24.0, 100.0)
                && !OtherMeshes::NONE.contains(24.0, 1.0)
        );
        let unusable = OtherMesh { mesh_orders: f64::NAN, shaft_orders: [1.0, 1.0] };
        assert!(OtherMeshes::of([unusable, OtherMesh::default()]).is_empty());
        assert!(!second_stage().is_empty());
    }
}
