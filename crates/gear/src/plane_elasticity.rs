//! Plane elasticity: the eight-node element, and the half-plane under a force on its edge.

use std::f64::consts::PI;

use super::{MaterialSpec, PlaneState};

/// Abscissas and weights of Gauss's rule with three points.
const GAUSS: [(f64, f64); 3] =
    [(-0.774_596_669_241_483_4, 5.0 / 9.0), (0.0, 8.0 / 9.0), (0.774_596_669_241_483_4, 5.0 / 9.0)];

/// Coordinates ξ, η of the element's nodes: the corners, then the midpoints of the sides between them.
const NODES: [[f64; 2]; 8] =
    [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]];

/// Stiffness matrix of an element, rows and columns x and y of each node in turn, in N/mm per mm of width.
pub(super) type ElementStiffness = [[f64; 16]; 16];

/// An isotropic material in a plane state, in MPa.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PlaneElasticity {
    /// Shear modulus.
    pub(super) shear_mpa: f64,
    /// Equivalent Poisson's ratio for plane strain.
    pub(super) poisson: f64,
}

impl PlaneElasticity {
    pub(super) fn new(material: &MaterialSpec, plane: PlaneState) -> Self {
        let poisson = material.poisson_ratio;
        Self {
            shear_mpa: material.youngs_modulus_pa * 1e-6 / (2.0 * (1.0 + poisson)),
            poisson: match plane {
                PlaneState::Strain => poisson,
                PlaneState::Stress => poisson / (1.0 + poisson),
            },
        }
    }

    /// Returns E* in MPa of two bodies of this material in contact.
    pub(super) fn contact_modulus_mpa(&self) -> f64 {
        self.shear_mpa / (1.0 - self.poisson)
    }

    /// Returns (1 − ν²)/E in 1/MPa for plane strain.
    pub(super) fn compliance_per_mpa(&self) -> f64 {
        (1.0 - self.poisson) / (2.0 * self.shear_mpa)
    }

    /// Returns the stiffness of the serendipity element with its nodes at `nodes` in mm; `None` if the
    /// element is inverted.
    pub(super) fn stiffness(&self, nodes: &[[f64; 2]; 8]) -> Option<ElementStiffness> {
        let scale = 2.0 * self.shear_mpa / (1.0 - 2.0 * self.poisson);
        let (direct, coupled, shear) = (scale * (1.0 - self.poisson), scale * self.poisson, self.shear_mpa);
        let mut stiffness = [[0.0; 16]; 16];
        for (xi, weight_xi) in GAUSS {
            for (eta, weight_eta) in GAUSS {
                let local = NODES.map(|node| shape_gradient(node, xi, eta));
                let mut jacobian = [[0.0; 2]; 2];
                for (gradient, node) in local.iter().zip(nodes) {
                    for (row, slope) in jacobian.iter_mut().zip(gradient) {
                        row[0] += slope * node[0];
                        row[1] += slope * node[1];
                    }
                }
                let determinant = jacobian[0][0] * jacobian[1][1] - jacobian[0][1] * jacobian[1][0];
                if determinant <= 0.0 {
                    return None;
                }
                let gradient = local.map(|[along_xi, along_eta]| {
                    [
                        (jacobian[1][1] * along_xi - jacobian[0][1] * along_eta) / determinant,
                        (jacobian[0][0] * along_eta - jacobian[1][0] * along_xi) / determinant,
                    ]
                });
                let weight = weight_xi * weight_eta * determinant;
                for (a, [ax, ay]) in gradient.iter().enumerate() {
                    for (b, [bx, by]) in gradient.iter().enumerate() {
                        stiffness[2 * a][2 * b] += weight * (direct * ax * bx + shear * ay * by);
                        stiffness[2 * a][2 * b + 1] += weight * (coupled * ax * by + shear * ay * bx);
                        stiffness[2 * a + 1][2 * b] += weight * (coupled * ay * bx + shear * ax * by);
                        stiffness[2 * a + 1][2 * b + 1] += weight * (direct * ay * by + shear * ax * bx);
                    }
                }
            }
        }
        Some(stiffness)
    }

    /// Returns the displacement in mm per 1 N/mm at a point `along` the edge and `deep` below it due to a
    /// force on the edge of a half-plane (Flamant), less a rigid motion: `[load][component]`, first along the
    /// edge, then into the body. Its logarithm is zero at 1 mm.
    pub(super) fn half_plane(&self, along_mm: f64, deep_mm: f64) -> [[f64; 2]; 2] {
        let squared = along_mm * along_mm + deep_mm * deep_mm;
        let logarithm = (1.0 - self.poisson) * squared.ln();
        let angle = (1.0 - 2.0 * self.poisson) * along_mm.atan2(deep_mm);
        let mixed = along_mm * deep_mm / squared;
        let unit = 1.0 / (2.0 * PI * self.shear_mpa);
        [
            [unit * (along_mm * along_mm / squared - logarithm), unit * (mixed + angle)],
            [unit * (mixed - angle), unit * (deep_mm * deep_mm / squared - logarithm)],
        ]
    }
}

/// Returns ∂N/∂ξ and ∂N/∂η of the node at `node`.
fn shape_gradient([a, b]: [f64; 2], xi: f64, eta: f64) -> [f64; 2] {
    if a == 0.0 {
        [-xi * (1.0 + b * eta), 0.5 * b * (1.0 - xi * xi)]
    } else if b == 0.0 {
        [0.5 * a * (1.0 - eta * eta), -eta * (1.0 + a * xi)]
    } else {
        [
            0.25 * a * (1.0 + b * eta) * (2.0 * a * xi + b * eta),
            0.25 * b * (1.0 + a * xi) * (a * xi + 2.0 * b * eta),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::PlaneElasticity;
    use crate::{MaterialSpec, PlaneState};

    /// A quadratic element holds every state of constant strain exactly, curved sides or not.
    #[test]
    fn element_holds_constant_strain() {
        let elasticity = PlaneElasticity::new(&MaterialSpec::default(), PlaneState::Strain);
        let nodes = [
            [0.0, 0.0],
            [2.0, 0.1],
            [2.2, 1.4],
            [-0.1, 1.1],
            [1.0, 0.0],
            [2.15, 0.8],
            [1.0, 1.3],
            [0.0, 0.5],
        ];
        let stiffness = elasticity.stiffness(&nodes).unwrap();
        // ε_x = 1e-3 alone: energy ½ λ+2μ ε² A against the element's, with A by the same map's divergence
        // theorem below.
        let energy = |motion: &dyn Fn([f64; 2]) -> [f64; 2]| -> f64 {
            let flat: Vec<f64> = nodes.iter().flat_map(|node| motion(*node)).collect();
            (0..16).map(|i| (0..16).map(|j| 0.5 * flat[i] * stiffness[i][j] * flat[j]).sum::<f64>()).sum()
        };
        let stretch = energy(&|[x, _]| [1e-3 * x, 0.0]);
        let shear = energy(&|[_, y]| [1e-3 * y, 0.0]);
        let rotation = energy(&|[x, y]| [-1e-3 * y, 1e-3 * x]);
        // (λ + 2μ)/μ = 2(1 − ν)/(1 − 2ν) = 3.5.
        assert!((stretch / shear - 3.5).abs() < 1e-12, "{}", stretch / shear);
        assert!(rotation.abs() < 1e-10 * shear);
    }

    /// On the edge the force's own displacement falls as −(1 − ν²)/(πE)·2 ln x and the sideways one is
    /// constant (Johnson, Contact Mechanics, Eqs. 2.23 and 2.24); reciprocity joins the two loads.
    #[test]
    fn half_plane_is_johnsons_on_the_edge() {
        let elasticity = PlaneElasticity::new(&MaterialSpec::default(), PlaneState::Strain);
        let (young, poisson) = (205e3, 0.3);
        let [near, far] = [0.5, 3.0].map(|x| elasticity.half_plane(x, 0.0));
        let drop = 2.0 * (1.0 - poisson * poisson) / (std::f64::consts::PI * young) * 6.0_f64.ln();
        assert!((near[1][1] - far[1][1] - drop).abs() < 1e-18);
        let sideways = -(1.0 - 2.0 * poisson) * (1.0 + poisson) / (2.0 * young);
        assert!((near[1][0] - sideways).abs() < 1e-18 && (far[1][0] - sideways).abs() < 1e-18);
        let back = elasticity.half_plane(-0.5, 0.0);
        assert!((near[1][0] - back[0][1]).abs() < 1e-18);
    }
}
