//! Finite-element mesh of one sector of a gear: a tooth with its fillets, and the ring below it down to the
//! bore.

use super::tooth_outline::{Point, ToothOutline};

/// Number of elements along the involute; the first at the tip is fine, as tip edges are loaded there.
const FLANK_ELEMENTS: usize = 10;
/// Length in modules of the element at the tip.
const TIP_ELEMENT_MODULES: f64 = 0.02;
/// Largest element on the involute relative to the mean one.
const MAX_OVER_MEAN: f64 = 1.25;
/// Number of elements along the part of the fillet above the tooth's base line, and below it.
const UPPER_FILLET_ELEMENTS: usize = 2;
const LOWER_FILLET_ELEMENTS: usize = 2;
/// Start of the base line: fraction of the fillet's turn from the involute.
const BASE_LINE_PART: f64 = 3.0 / 7.0;
/// Relative widths of the elements across the tooth, finer below the flanks where displacements are
/// evaluated.
const ACROSS_TOOTH: [f64; 6] = [0.35, 0.8, 1.2, 1.2, 0.8, 0.35];
/// Number of elements from the root to the bore, and the ratio of their lengths inwards.
const RING_ELEMENTS: usize = 5;
const RING_GROWTH: f64 = 1.6;

/// Columns of the tooth's and of the ring's node grid: corners and middles of the sides.
const TOOTH_COLUMNS: usize = 2 * ACROSS_TOOTH.len();
const RING_COLUMNS: usize = TOOTH_COLUMNS + 4 * LOWER_FILLET_ELEMENTS;
const TOOTH_ROWS: usize = 2 * (FLANK_ELEMENTS + UPPER_FILLET_ELEMENTS);
const RING_ROWS: usize = 2 * RING_ELEMENTS;

/// A corner of the mesh on the working flank, with the nodes below it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FlankStation {
    /// Radius in mm of the unworn flank point.
    pub(super) radius_mm: f64,
    /// Node on the flank.
    pub(super) node: usize,
    /// Nodes one and two elements inside.
    pub(super) inside: [usize; 2],
}

/// The mesh: nodes are numbered from the tip to the bore, which keeps the stiffness matrix's band narrow.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SectorMesh {
    /// Coordinates in mm in the tooth's system X, Y.
    pub(super) nodes: Vec<Point>,
    /// Eight-node elements, corners then sides' middles, counter-clockwise.
    pub(super) elements: Vec<[usize; 8]>,
    /// Stations on the flank on the side of positive Y, from the fillet to the tip.
    pub(super) flank: Vec<FlankStation>,
    /// Nodes on the sides of the sector, negative and positive Y, from the root to the bore without it.
    pub(super) sides: [Vec<usize>; 2],
    /// Nodes on the bore.
    pub(super) bore: Vec<usize>,
}

/// Numbers of the nodes of a grid of eight-node elements: rows with the elements' corners have all columns,
/// the others every second.
struct Grid {
    first: Vec<usize>,
}

impl Grid {
    fn node(&self, row: usize, column: usize) -> usize {
        self.first[row] + if row.is_multiple_of(2) { column } else { column / 2 }
    }

    /// Elements of all cells, of `columns` node columns besides the first; `outwards` where rows go towards
    /// the tip.
    fn elements(&self, columns: usize, outwards: bool) -> impl Iterator<Item = [usize; 8]> + '_ {
        let rows = (0..self.first.len() - 2).step_by(2);
        rows.flat_map(move |i| (0..columns).step_by(2).map(move |j| (i, j))).map(move |(i, j)| {
            let (low, high) = if outwards { (i, i + 2) } else { (i + 2, i) };
            // X points out and Y across, so counter-clockwise is up along a column first.
            [
                self.node(low, j),
                self.node(high, j),
                self.node(high, j + 2),
                self.node(low, j + 2),
                self.node(i + 1, j),
                self.node(high, j + 1),
                self.node(i + 1, j + 2),
                self.node(low, j + 1),
            ]
        })
    }
}

impl SectorMesh {
    /// Meshes the tooth, worn on the side of positive Y, and its part of the ring down to the bore;
    /// `depth_mm` is the wear along Y over the radius in mm of the involute's points.
    pub(super) fn new(
        outline: &ToothOutline,
        module_mm: f64,
        bore_radius_mm: f64,
        depth_mm: impl Fn(f64) -> f64,
    ) -> Self {
        let edge = FlankEdge::new(outline, module_mm, depth_mm);
        let across = fractions(&ACROSS_TOOTH);
        let top = ring_top(outline, &edge, &across);
        let inwards: Vec<f64> = (0..RING_ELEMENTS).map(|i| RING_GROWTH.powi(i as i32)).collect();
        let inwards = fractions(&inwards);

        let mut nodes = Vec::new();
        let mut tooth = Grid { first: vec![0; TOOTH_ROWS + 1] };
        for row in (1..=TOOTH_ROWS).rev() {
            tooth.first[row] = nodes.len();
            nodes.extend(columns(row, TOOTH_COLUMNS).map(|column| edge.inside(outline, row, across[column])));
        }
        let mut ring = Grid { first: Vec::new() };
        for (row, depth) in inwards.iter().enumerate() {
            ring.first.push(nodes.len());
            nodes.extend(columns(row, RING_COLUMNS).map(|column| {
                let [x, y] = top[column];
                let radius = x.hypot(y);
                let part = (radius + (bore_radius_mm - radius) * depth) / radius;
                [x * part, y * part]
            }));
        }
        tooth.first[0] = ring.first[0] + 2 * LOWER_FILLET_ELEMENTS;

        let station = |row: usize| FlankStation {
            radius_mm: edge.radii_mm[row - 2 * UPPER_FILLET_ELEMENTS],
            node: tooth.node(row, TOOTH_COLUMNS),
            inside: [tooth.node(row, TOOTH_COLUMNS - 2), tooth.node(row, TOOTH_COLUMNS - 4)],
        };
        Self {
            elements: tooth.elements(TOOTH_COLUMNS, true).chain(ring.elements(RING_COLUMNS, false)).collect(),
            flank: (2 * UPPER_FILLET_ELEMENTS..=TOOTH_ROWS).step_by(2).map(station).collect(),
            sides: [0, RING_COLUMNS].map(|column| (0..RING_ROWS).map(|row| ring.node(row, column)).collect()),
            bore: (0..=RING_COLUMNS).map(|column| ring.node(RING_ROWS, column)).collect(),
            nodes,
        }
    }
}

/// Returns the columns that have a node in a row.
fn columns(row: usize, last: usize) -> impl Iterator<Item = usize> {
    (0..=last).step_by(if row.is_multiple_of(2) { 1 } else { 2 })
}

/// Returns the positions of corners and midpoints in [0, 1] for elements of these relative widths.
fn fractions(widths: &[f64]) -> Vec<f64> {
    let total: f64 = widths.iter().sum();
    let mut places = vec![0.0];
    let mut reached = 0.0;
    for width in widths {
        places.push((reached + 0.5 * width) / total);
        reached += width;
        places.push(reached / total);
    }
    places
}

/// The tooth's edge from its base line up to the tip.
struct FlankEdge {
    /// Corners and middles from the base line to the tip.
    points: Vec<Point>,
    /// Radii of those on the involute.
    radii_mm: Vec<f64>,
    /// Wear at all of them along Y; below the involute it runs out to the base line.
    depths_mm: Vec<f64>,
}

impl FlankEdge {
    fn new(outline: &ToothOutline, module_mm: f64, depth_mm: impl Fn(f64) -> f64) -> Self {
        let widths: Vec<f64> = element_lengths(outline.tip_radius_mm - outline.form_radius_mm, module_mm)
            .into_iter()
            .rev()
            .collect();
        let height = outline.tip_radius_mm - outline.form_radius_mm;
        let radii_mm: Vec<f64> =
            fractions(&widths).iter().map(|part| outline.form_radius_mm + height * part).collect();
        let upper = 2 * UPPER_FILLET_ELEMENTS;
        let fillet = (0..upper)
            .map(|i| outline.fillet(outline.fillet_normal(BASE_LINE_PART * (1.0 - i as f64 / upper as f64))));
        let at_form = depth_mm(outline.form_radius_mm);
        let run_out = (0..upper).map(|i| at_form * i as f64 / upper as f64);
        Self {
            depths_mm: run_out.chain(radii_mm.iter().map(|radius| depth_mm(*radius))).collect(),
            points: fillet.chain(radii_mm.iter().map(|radius| outline.flank(*radius))).collect(),
            radii_mm,
        }
    }

    /// Returns the position of a node of a row, at a fraction of the distance from the far flank to this one.
    fn inside(&self, outline: &ToothOutline, row: usize, across: f64) -> Point {
        let [x, y] = self.points[row];
        let upper = 2 * UPPER_FILLET_ELEMENTS;
        // The rows bend with the tip circle, less with increasing distance from it.
        let ([low, _], [high, half]) = (self.points[upper], self.points[TOOTH_ROWS]);
        let bend = ((x - low) / (high - low)).clamp(0.0, 1.0);
        let lateral = 2.0 * across - 1.0;
        let tip_angle = half.atan2(high) * lateral;
        let rise = outline.tip_radius_mm * tip_angle.cos() - high;
        let shift = outline.tip_radius_mm * tip_angle.sin() - half * lateral;
        [x + bend * rise, y * lateral + bend * shift - self.depths_mm[row] * across]
    }
}

/// Returns the lengths of the involute's elements from the tip on: increasing from a fine one up to the
/// largest.
fn element_lengths(height_mm: f64, module_mm: f64) -> Vec<f64> {
    let mean = height_mm / FLANK_ELEMENTS as f64;
    let (first, greatest) = ((TIP_ELEMENT_MODULES * module_mm).min(0.5 * mean), MAX_OVER_MEAN * mean);
    let lengths = |growth: f64| -> Vec<f64> {
        (0..FLANK_ELEMENTS).map(|i| (first * growth.powi(i as i32)).min(greatest)).collect()
    };
    let (mut low, mut high) = (1.0, 20.0);
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if lengths(middle).iter().sum::<f64>() < height_mm {
            low = middle;
        } else {
            high = middle;
        }
    }
    lengths(high)
}

/// Returns the ring's upper boundary from one side of the sector to the other: root circle, lower fillet,
/// base line, lower fillet, root circle.
fn ring_top(outline: &ToothOutline, edge: &FlankEdge, across: &[f64]) -> Vec<Point> {
    const PIECES: usize = 64;
    let (sin, cos) = (0.5 * outline.pitch_angle_rad).sin_cos();
    let mut curve = vec![[outline.root_radius_mm * cos, outline.root_radius_mm * sin]];
    curve.extend((0..=PIECES).map(|i| {
        outline.fillet(outline.fillet_normal(1.0 - (1.0 - BASE_LINE_PART) * i as f64 / PIECES as f64))
    }));
    let mut lengths = vec![0.0];
    for two in curve.windows(2) {
        let length = (two[1][0] - two[0][0]).hypot(two[1][1] - two[0][1]);
        lengths.push(lengths[lengths.len() - 1] + length);
    }
    let total = lengths[lengths.len() - 1];
    let count = 2 * LOWER_FILLET_ELEMENTS;
    let lower: Vec<Point> = (0..count)
        .map(|i| {
            let wanted = total * i as f64 / count as f64;
            let after = lengths.partition_point(|length| *length <= wanted).clamp(1, lengths.len() - 1);
            let part = (wanted - lengths[after - 1]) / (lengths[after] - lengths[after - 1]);
            let (a, b) = (curve[after - 1], curve[after]);
            [a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1])]
        })
        .collect();
    let mirrored = lower.iter().map(|[x, y]| [*x, -y]);
    let base = across.iter().map(|part| edge.inside(outline, 0, *part));
    mirrored.chain(base).chain(lower.iter().rev().copied()).collect()
}

#[cfg(test)]
mod tests {
    use super::SectorMesh;
    use crate::tooth_outline::ToothOutline;
    use crate::{MaterialSpec, PairSpec, PlaneState, plane_elasticity::PlaneElasticity};

    /// Every element of gears from few to many teeth is sound, and the mesh fills the sector: the ring's and
    /// the tooth's area.
    #[test]
    fn meshes_small_and_large_gears() {
        let mut spec = PairSpec::from_toml(include_str!("../../../fixtures/pairs/shen2022.toml")).unwrap();
        spec.geometry.centre_distance_mm = None;
        let elasticity = PlaneElasticity::new(&MaterialSpec::default(), PlaneState::Strain);
        for (teeth, shift, bore) in
            [([24, 26], 0.0, 20.0), ([12, 90], 0.45, 8.0), ([17, 300], 0.2, 12.0), ([40, 41], -0.3, 70.0)]
        {
            spec.geometry.teeth = teeth;
            spec.geometry.profile_shift = [shift, -0.2 * shift];
            spec.geometry.bore_radius_mm = Some([bore, bore]);
            let pair = spec.resolve().unwrap();
            for i in 0..2 {
                let outline = ToothOutline::new(&pair, i);
                let mesh = SectorMesh::new(&outline, 6.0, bore, |_| 0.05);
                for element in &mesh.elements {
                    assert!(
                        elasticity.stiffness(&element.map(|node| mesh.nodes[node])).is_some(),
                        "{teeth:?} {i}"
                    );
                }
                assert_eq!(mesh.sides[0].len(), mesh.sides[1].len());
                assert!((mesh.flank.last().unwrap().radius_mm - outline.tip_radius_mm).abs() < 1e-9);
            }
        }
    }
}
