//! Compliance of one gear's flanks under forces on its teeth, with the bore fixed: bending, shear and
//! compression of the teeth, their foundation in the ring, the ring's torsion, and the coupling of
//! neighbouring teeth through the ring.
//!
//! The whole gear is a plane finite-element model. All its sectors are identical, so one is condensed to its
//! two sides, and the rest of the ring is made of copies by repeated doubling. Under a point force the
//! displacement is singular. The half-plane's displacement (Flamant) is subtracted inside the tooth, which
//! leaves a smooth compliance of the body; the local part of the contact is added in [`super::line_contact`].

use std::f64::consts::{FRAC_PI_2, PI};

use super::plane_elasticity::PlaneElasticity;
use super::ring_sector::RingSector;
use super::sector_mesh::{FlankStation, SectorMesh};
use super::tooth_outline::ToothOutline;
use super::{Flank, GearError};

/// Number of teeth on each side whose displacement is computed.
pub(super) const REACH: usize = 3;
/// Distance in modules from the tip edge within which the compliance follows the wedge solution.
const WEDGE_REACH_MODULES: f64 = 0.075;
/// Smallest distance from the edge in modules.
const MIN_DISTANCE_MODULES: f64 = 1e-4;

/// `[load][component]`, X then Y of the tooth's coordinates; mm for 1 N/mm.
type Tensor = [[f64; 2]; 2];

/// Compliance of one gear's flanks.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct BodyCompliance {
    /// Radii in mm of the unworn flank points in the tables.
    radii_mm: Vec<f64>,
    /// Compliance of the loaded tooth itself, without the half-plane's part.
    own: Vec<Tensor>,
    /// Displacement on a tooth `offset` teeth further towards positive Y,
    /// `across[offset + reach][load × stations + place]`.
    across: Vec<Vec<Tensor>>,
    reach: usize,
    tip: TipWedge,
}

/// The compliance near the tip's edge, where the tooth is a wedge and not a half-plane.
#[derive(Debug, Clone, PartialEq)]
struct TipWedge {
    tip_radius_mm: f64,
    /// Length of flank to length of radius.
    flank_per_radius: f64,
    /// Distance from the edge in mm up to which the law holds, and the least.
    reach_mm: f64,
    least_mm: f64,
    /// Compliance there and its slope over the distance, less the logarithm's.
    at_reach: Tensor,
    slope: Tensor,
    /// The logarithm's factor.
    logarithm: Tensor,
}

impl BodyCompliance {
    /// Computes the compliance of gear number `gear` (0 or 1) of its pair, thinned by the wear of its flank.
    ///
    /// # Errors
    /// [`GearError::ElasticModel`] if the gear's shape cannot be meshed.
    pub(super) fn new(
        gear: usize,
        outline: &ToothOutline,
        flank: &Flank<'_>,
        module_mm: f64,
        elasticity: &PlaneElasticity,
    ) -> Result<Self, GearError> {
        let at_radius = |radius: f64| flank.at(flank.alpha_at_radius_rad(radius));
        let mesh = SectorMesh::new(outline, module_mm, flank.gear.bore_radius_mm, |radius| {
            at_radius(radius).depth_mm
        });
        let teeth = (2.0 * PI / outline.pitch_angle_rad).round() as usize;
        let sector = RingSector::new(&mesh, elasticity, outline.pitch_angle_rad)
            .ok_or(GearError::ElasticModel { gear: gear + 1 })?;
        let reach = REACH.min((teeth - 2) / 2);
        let sides =
            sector.side_displacements(teeth, reach).ok_or(GearError::ElasticModel { gear: gear + 1 })?;

        let stations = &mesh.flank;
        let across = (0..=2 * reach)
            .map(|index| {
                let at = |load: usize, place: usize| {
                    sector.displacement(&sides, index, load, stations[place].node)
                };
                let loads =
                    (0..stations.len()).flat_map(|load| (0..stations.len()).map(move |place| (load, place)));
                loads.map(|(load, place)| at(load, place)).collect()
            })
            .collect();
        let own: Vec<Tensor> = (0..stations.len())
            .map(|load| {
                let at = |node: usize| sector.displacement(&sides, reach, load, node);
                let inclination = at_radius(stations[load].radius_mm).lambda_rad;
                own_compliance(&mesh, &stations[load], inclination, elasticity, at)
            })
            .collect();
        let radii_mm: Vec<f64> = stations.iter().map(|station| station.radius_mm).collect();
        let tip = TipWedge::new(outline, module_mm, elasticity, &radii_mm, &own);
        Ok(Self { radii_mm, own, across, reach, tip })
    }

    /// Returns the displacement in mm along the direction `(sin, cos)` of a force of 1 N/mm in the same
    /// direction at a radius of the flank, without the half-plane's displacement at 1 mm.
    pub(super) fn own(&self, radius_mm: f64, direction: [f64; 2]) -> f64 {
        let distance = (self.tip.tip_radius_mm - radius_mm) * self.tip.flank_per_radius;
        let tensor = if distance < self.tip.reach_mm {
            self.tip.at(distance)
        } else {
            interpolate(&self.radii_mm, &self.own, radius_mm)
        };
        project(&tensor, direction, direction)
    }

    /// Returns the radius in mm of the flank point at a distance in mm from the tip edge along the flank.
    pub(super) fn radius_at(&self, from_edge_mm: f64) -> f64 {
        self.tip.tip_radius_mm - from_edge_mm / self.tip.flank_per_radius
    }

    /// Returns the displacement in mm at a point of the tooth `offset` teeth towards positive Y from the one
    /// loaded by a force of 1 N/mm.
    pub(super) fn across(&self, offset: i32, load: (f64, [f64; 2]), place: (f64, [f64; 2])) -> f64 {
        let Some(table) =
            usize::try_from(offset + self.reach as i32).ok().and_then(|index| self.across.get(index))
        else {
            return 0.0;
        };
        let count = self.radii_mm.len();
        let (first_load, load_weights) = cubic_weights(&self.radii_mm, load.0);
        let (first_place, place_weights) = cubic_weights(&self.radii_mm, place.0);
        let mut tensor = Tensor::default();
        for (i, a) in load_weights.iter().enumerate() {
            for (j, b) in place_weights.iter().enumerate() {
                add(&mut tensor, &table[(first_load + i) * count + first_place + j], a * b);
            }
        }
        project(&tensor, load.1, place.1)
    }
}

impl TipWedge {
    /// Solution for a force near the edge of a wedge. Far from the edge the displacement is that of the
    /// wedge's apex (Michell), close to the force that of a half-plane. So the compliance grows with the
    /// logarithm of the distance times the difference of both factors.
    fn new(
        outline: &ToothOutline,
        module_mm: f64,
        elasticity: &PlaneElasticity,
        radii_mm: &[f64],
        own: &[Tensor],
    ) -> Self {
        let tip = outline.tip_radius_mm;
        let profile_angle = outline.profile_angle(tip);
        let half = 0.5 * (FRAC_PI_2 + profile_angle);
        let (sin, cos) = outline.inclination(tip).sin_cos();
        // From the edge into the tooth between flank and tip circle, and across it.
        let bisector = [-cos * half.cos() - sin * half.sin(), sin * half.cos() - cos * half.sin()];
        let aside = [-bisector[1], bisector[0]];
        let (along, across) =
            (1.0 / (half + 0.5 * (2.0 * half).sin()), 1.0 / (half - 0.5 * (2.0 * half).sin()));
        let mut logarithm = Tensor::default();
        for i in 0..2 {
            for j in 0..2 {
                let half_plane = if i == j { 2.0 / PI } else { 0.0 };
                logarithm[i][j] = elasticity.compliance_per_mpa()
                    * (along * bisector[i] * bisector[j] + across * aside[i] * aside[j] - half_plane);
            }
        }
        let flank_per_radius = 1.0 / profile_angle.cos();
        let reach_mm = WEDGE_REACH_MODULES * module_mm;
        let radius = |distance: f64| tip - distance / flank_per_radius;
        let at_reach = interpolate(radii_mm, own, radius(reach_mm));
        let step = 0.25 * reach_mm;
        let (before, after) = (
            interpolate(radii_mm, own, radius(reach_mm - step)),
            interpolate(radii_mm, own, radius(reach_mm + step)),
        );
        let mut slope = Tensor::default();
        add(&mut slope, &after, 0.5 / step);
        add(&mut slope, &before, -0.5 / step);
        add(&mut slope, &logarithm, 1.0 / reach_mm);
        Self {
            tip_radius_mm: tip,
            flank_per_radius,
            reach_mm,
            least_mm: MIN_DISTANCE_MODULES * module_mm,
            at_reach,
            slope,
            logarithm,
        }
    }

    fn at(&self, distance_mm: f64) -> Tensor {
        let distance = distance_mm.max(self.least_mm);
        let mut tensor = self.at_reach;
        add(&mut tensor, &self.slope, distance - self.reach_mm);
        add(&mut tensor, &self.logarithm, -(distance / self.reach_mm).ln());
        tensor
    }
}

fn add(sum: &mut Tensor, tensor: &Tensor, factor: f64) {
    for (row, other) in sum.iter_mut().zip(tensor) {
        row.iter_mut().zip(other).for_each(|(value, part)| *value += factor * part);
    }
}

fn project(tensor: &Tensor, load: [f64; 2], place: [f64; 2]) -> f64 {
    (0..2).map(|i| load[i] * (tensor[i][0] * place[0] + tensor[i][1] * place[1])).sum()
}

/// First node and weights of the cubic through the four nodes around `x`.
fn cubic_weights(nodes: &[f64], x: f64) -> (usize, [f64; 4]) {
    let first = nodes.partition_point(|node| *node <= x).saturating_sub(2).min(nodes.len() - 4);
    let four = &nodes[first..first + 4];
    let weight = |i: usize| (0..4).filter(|j| *j != i).map(|j| (x - four[j]) / (four[i] - four[j])).product();
    (first, std::array::from_fn(weight))
}

fn interpolate(nodes: &[f64], tensors: &[Tensor], x: f64) -> Tensor {
    let (first, weights) = cubic_weights(nodes, x);
    let mut tensor = Tensor::default();
    for (weight, part) in weights.iter().zip(&tensors[first..]) {
        add(&mut tensor, part, *weight);
    }
    tensor
}

/// Returns the compliance of a station without the half-plane's part: evaluated at two depths and
/// extrapolated to the surface.
fn own_compliance(
    mesh: &SectorMesh,
    station: &FlankStation,
    inclination_rad: f64,
    elasticity: &PlaneElasticity,
    displacement: impl Fn(usize) -> Tensor,
) -> Tensor {
    let (sin, cos) = inclination_rad.sin_cos();
    // Along the flank towards the tip, and into the tooth.
    let axes = [[cos, -sin], [-sin, -cos]];
    let [flank_x, flank_y] = mesh.nodes[station.node];
    let read = |node: usize| {
        let [x, y] = mesh.nodes[node];
        let offset = [x - flank_x, y - flank_y];
        let [along, deep] = axes.map(|axis| axis[0] * offset[0] + axis[1] * offset[1]);
        let local = elasticity.half_plane(along, deep);
        let mut tensor = displacement(node);
        for i in 0..2 {
            for j in 0..2 {
                for (load, row) in axes.iter().zip(local) {
                    tensor[i][j] -= load[i] * (row[0] * axes[0][j] + row[1] * axes[1][j]);
                }
            }
        }
        (tensor, along.hypot(deep))
    };
    let [(near, near_depth), (far, far_depth)] = station.inside.map(read);
    let outwards = near_depth / (far_depth - near_depth);
    let mut tensor = Tensor::default();
    add(&mut tensor, &near, 1.0 + outwards);
    add(&mut tensor, &far, -outwards);
    let mixed = 0.5 * (tensor[0][1] + tensor[1][0]);
    (tensor[0][1], tensor[1][0]) = (mixed, mixed);
    tensor
}
