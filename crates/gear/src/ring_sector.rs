//! One sector of a gear condensed to its two sides, and the whole gear composed of copies of it.

use nalgebra::{Cholesky, DMatrix};

use super::band_matrix::BandMatrix;
use super::plane_elasticity::PlaneElasticity;
use super::sector_mesh::SectorMesh;

/// Stiffness between the negative side (`low`) and the positive side (`high`) of one or more sectors, each
/// side in the coordinates of the sector that starts there.
#[derive(Debug, Clone)]
struct Arc {
    low: DMatrix<f64>,
    low_high: DMatrix<f64>,
    high: DMatrix<f64>,
}

impl Arc {
    /// Joins two consecutive arcs.
    fn join(&self, next: &Self) -> Option<Self> {
        let middle = Cholesky::new(&self.high + &next.low)?;
        let before = middle.solve(&self.low_high.transpose());
        let after = middle.solve(&next.low_high);
        Some(Self {
            low: &self.low - &self.low_high * &before,
            low_high: -(&self.low_high * &after),
            high: &next.high - next.low_high.transpose() * &after,
        })
    }

    /// Joins `count` (at least 1) of these arcs.
    fn repeat(&self, mut count: usize) -> Option<Self> {
        let mut power = self.clone();
        let mut row: Option<Self> = None;
        loop {
            if count & 1 == 1 {
                row = Some(match row {
                    Some(row) => row.join(&power)?,
                    None => power.clone(),
                });
            }
            count >>= 1;
            if count == 0 {
                return row;
            }
            power = power.join(&power)?;
        }
    }
}

/// Displacements of the sides of the sectors near the loaded one, for unit forces in X and Y at each station
/// of its flank.
#[derive(Debug, Clone)]
pub(super) struct SideDisplacements {
    /// Row: sides from the first sector's negative one on; column: twice the station and the component.
    values: DMatrix<f64>,
    reach: usize,
}

/// A sector's own solution.
#[derive(Debug, Clone)]
pub(super) struct RingSector {
    arc: Arc,
    /// Number of degrees of freedom of both sides.
    sides: usize,
    /// Number of forces: two per station.
    loads: usize,
    /// Inner displacements with fixed sides: for a unit displacement of each side degree of freedom, then for
    /// each unit force.
    inner: Vec<f64>,
    /// First inner degree of freedom of each node, if any.
    freedoms: Vec<Option<usize>>,
    /// Inner degree of freedom of each force.
    loaded: Vec<usize>,
}

impl RingSector {
    /// Condenses the sector of a mesh; `None` if an element is inverted.
    pub(super) fn new(mesh: &SectorMesh, elasticity: &PlaneElasticity, pitch_angle_rad: f64) -> Option<Self> {
        let side_nodes = mesh.sides[0].len();
        let sides = 4 * side_nodes;
        // Target of each node's displacement: inner degrees of freedom, side degrees of freedom, or none on
        // the bore.
        let mut place: Vec<NodeKind> = vec![NodeKind::Inner(0); mesh.nodes.len()];
        for node in &mesh.bore {
            place[*node] = NodeKind::Fixed;
        }
        for (side, nodes) in mesh.sides.iter().enumerate() {
            for (i, node) in nodes.iter().enumerate() {
                place[*node] = NodeKind::Side(2 * (side * side_nodes + i), side == 1);
            }
        }
        let mut inner_count = 0;
        for at in &mut place {
            if let NodeKind::Inner(first) = at {
                *first = inner_count;
                inner_count += 2;
            }
        }
        let freedoms: Vec<Option<usize>> = place
            .iter()
            .map(|at| if let NodeKind::Inner(first) = at { Some(*first) } else { None })
            .collect();
        let spread = |element: &[usize; 8]| {
            let inner = element.iter().filter_map(|node| freedoms[*node]);
            let (least, most) =
                inner.fold((usize::MAX, 0), |(least, most), at| (least.min(at), most.max(at)));
            (most + 1).saturating_sub(least)
        };
        let half_band = mesh.elements.iter().map(spread).max()?;

        let loads = 2 * mesh.flank.len();
        let count = sides + loads;
        let mut matrix = BandMatrix::zeros(inner_count, half_band);
        let mut right = vec![0.0; inner_count * count];
        let mut side_matrix = DMatrix::zeros(sides, sides);
        let (sin, cos) = pitch_angle_rad.sin_cos();
        for element in &mesh.elements {
            let stiffness = elasticity.stiffness(&element.map(|node| mesh.nodes[node]))?;
            // An element's degree of freedom in terms of the model's: the positive side is in the next
            // sector's coordinates.
            let parts = |local: usize| -> [(Freedom, f64); 2] {
                let component = local % 2;
                match place[element[local / 2]] {
                    NodeKind::Inner(first) => {
                        [(Freedom::Inner(first + component), 1.0), (Freedom::Fixed, 0.0)]
                    }
                    NodeKind::Side(first, false) => {
                        [(Freedom::Side(first + component), 1.0), (Freedom::Fixed, 0.0)]
                    }
                    NodeKind::Side(first, true) => {
                        let turned = if component == 0 { [cos, -sin] } else { [sin, cos] };
                        [(Freedom::Side(first), turned[0]), (Freedom::Side(first + 1), turned[1])]
                    }
                    NodeKind::Fixed => [(Freedom::Fixed, 0.0); 2],
                }
            };
            for (i, row) in stiffness.iter().enumerate() {
                for (j, value) in row.iter().enumerate() {
                    for (a, a_part) in parts(i) {
                        for (b, b_part) in parts(j) {
                            let value = value * a_part * b_part;
                            match (a, b) {
                                (Freedom::Inner(a), Freedom::Inner(b)) if b <= a => matrix.add(a, b, value),
                                (Freedom::Inner(a), Freedom::Side(b)) => right[a * count + b] -= value,
                                (Freedom::Side(a), Freedom::Side(b)) => side_matrix[(a, b)] += value,
                                _ => {}
                            }
                        }
                    }
                }
            }
        }
        let coupling: Vec<f64> =
            (0..inner_count).flat_map(|row| right[row * count..row * count + sides].to_vec()).collect();
        let mut loaded = Vec::with_capacity(loads);
        for (station, at) in mesh.flank.iter().enumerate() {
            let first = freedoms[at.node]?;
            for component in 0..2 {
                right[(first + component) * count + sides + 2 * station + component] = 1.0;
                loaded.push(first + component);
            }
        }
        matrix.factor()?.solve(&mut right, count);
        // K_BB − K_BI K_II⁻¹ K_IB, with −K_IB in `coupling` and −K_II⁻¹ K_IB in `right`.
        for row in 0..inner_count {
            let coupled = &coupling[row * sides..(row + 1) * sides];
            for (a, factor) in coupled.iter().enumerate().filter(|(_, factor)| **factor != 0.0) {
                for b in 0..sides {
                    side_matrix[(a, b)] -= factor * right[row * count + b];
                }
            }
        }
        let half = sides / 2;
        Some(Self {
            arc: Arc {
                low: side_matrix.view((0, 0), (half, half)).into_owned(),
                low_high: side_matrix.view((0, half), (half, half)).into_owned(),
                high: side_matrix.view((half, half), (half, half)).into_owned(),
            },
            sides,
            loads,
            inner: right,
            freedoms,
            loaded,
        })
    }

    /// Returns the displacements of the sides of the loaded sector and of `reach` sectors on both sides of
    /// it, in a gear of `teeth` sectors (at least 2·`reach` + 2).
    pub(super) fn side_displacements(&self, teeth: usize, reach: usize) -> Option<SideDisplacements> {
        let near = 2 * reach + 1;
        let half = self.sides / 2;
        let size = (near + 1) * half;
        let mut matrix = DMatrix::zeros(size, size);
        let mut couple = |arc: &Arc, low: usize, high: usize| {
            let mut add = |row: usize, column: usize, block: &DMatrix<f64>| {
                let mut view = matrix.view_mut((row * half, column * half), (half, half));
                view += block;
            };
            add(low, low, &arc.low);
            add(low, high, &arc.low_high);
            add(high, low, &arc.low_high.transpose());
            add(high, high, &arc.high);
        };
        for sector in 0..near {
            couple(&self.arc, sector, sector + 1);
        }
        couple(&self.arc.repeat(teeth - near)?, near, 0);
        let mut values = DMatrix::zeros(size, self.loads);
        let count = self.sides + self.loads;
        for (load, freedom) in self.loaded.iter().enumerate() {
            for side in 0..self.sides {
                values[(reach * half + side, load)] = self.inner[freedom * count + side];
            }
        }
        Cholesky::new(matrix)?.solve_mut(&mut values);
        Some(SideDisplacements { values, reach })
    }

    /// Returns the displacement of a node of the sector `index` − reach sectors from the loaded one, for unit
    /// forces in X and Y at a station: `[load][component]` in that sector's coordinates.
    pub(super) fn displacement(
        &self,
        near: &SideDisplacements,
        index: usize,
        station: usize,
        node: usize,
    ) -> [[f64; 2]; 2] {
        let count = self.sides + self.loads;
        let start = index * self.sides / 2;
        let mut tensor = [[0.0; 2]; 2];
        let Some(first) = self.freedoms[node] else {
            return tensor;
        };
        for (load, row) in tensor.iter_mut().enumerate() {
            for (component, value) in row.iter_mut().enumerate() {
                let inner = &self.inner[(first + component) * count..][..count];
                let column = 2 * station + load;
                let by_sides: f64 =
                    (0..self.sides).map(|side| inner[side] * near.values[(start + side, column)]).sum();
                let direct = if index == near.reach { inner[self.sides + column] } else { 0.0 };
                *value = by_sides + direct;
            }
        }
        tensor
    }
}

/// Location of a node's two degrees of freedom.
#[derive(Debug, Clone, Copy)]
enum NodeKind {
    Inner(usize),
    /// Degree of freedom among the sides', and whether it is in the next sector's coordinates.
    Side(usize, bool),
    Fixed,
}

#[derive(Debug, Clone, Copy)]
enum Freedom {
    Inner(usize),
    Side(usize),
    Fixed,
}
