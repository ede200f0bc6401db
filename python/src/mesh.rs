//! Results of the gear model as arrays.

use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;

/// One mesh period over the rotation φ₁ of the driving gear.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct MeshCycle {
    /// Rotation of the driving gear in rad, shape ``(points,)``.
    phi1_rad: Py<PyArray1<f64>>,
    /// Rotation of the driven gear in rad, shape ``(points,)``.
    phi2_rad: Py<PyArray1<f64>>,
    /// Mesh stiffness in N/m, shape ``(points,)``.
    stiffness_n_per_m: Py<PyArray1<f64>>,
    /// Unloaded static transmission error in rad, shape ``(points,)``.
    uste_rad: Py<PyArray1<f64>>,
    /// Number of tooth pairs in contact, shape ``(points,)``.
    pairs_in_contact: Py<PyArray1<u32>>,
    /// Mean of the mesh stiffness in N/m.
    mean_stiffness_n_per_m: f64,
}

impl MeshCycle {
    pub(crate) fn new(py: Python<'_>, cycle: flankwatch_gear::MeshCycle) -> Self {
        Self {
            mean_stiffness_n_per_m: cycle.mean_stiffness_n_per_m(),
            phi1_rad: cycle.phi1_rad.into_pyarray(py).unbind(),
            phi2_rad: cycle.phi2_rad.into_pyarray(py).unbind(),
            stiffness_n_per_m: cycle.stiffness_n_per_m.into_pyarray(py).unbind(),
            uste_rad: cycle.uste_rad.into_pyarray(py).unbind(),
            pairs_in_contact: cycle.pairs_in_contact.into_pyarray(py).unbind(),
        }
    }
}

/// Contact points and rotations of one pair of teeth, from the start to the end of its contact.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct ToothContact {
    /// Angle α₁ of the point of contact on the driving flank in rad, shape ``(601,)``.
    alpha1_rad: Py<PyArray1<f64>>,
    /// The same angle α₁′ on the driven flank in rad, shape ``(601,)``.
    alpha1_prime_rad: Py<PyArray1<f64>>,
    /// Rotation φ₁ of the driving gear in rad, shape ``(601,)``.
    phi1_rad: Py<PyArray1<f64>>,
    /// Rotation φ₂ of the driven gear in rad, shape ``(601,)``.
    phi2_rad: Py<PyArray1<f64>>,
}

impl ToothContact {
    pub(crate) fn new(py: Python<'_>, contact: flankwatch_gear::MeshRelationship) -> Self {
        Self {
            alpha1_rad: contact.alpha1_rad.into_pyarray(py).unbind(),
            alpha1_prime_rad: contact.alpha1_prime_rad.into_pyarray(py).unbind(),
            phi1_rad: contact.phi1_rad.into_pyarray(py).unbind(),
            phi2_rad: contact.phi2_rad.into_pyarray(py).unbind(),
        }
    }
}

/// One flank from the start of active profile to the tip.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct Flank {
    /// Radius in mm, shape ``(points,)``.
    radius_mm: Py<PyArray1<f64>>,
    /// Wear depth in µm, shape ``(points,)``.
    depth_um: Py<PyArray1<f64>>,
    /// Coordinate x of the worn flank in mm, shape ``(points,)``.
    x_mm: Py<PyArray1<f64>>,
    /// Coordinate y of the worn flank in mm, shape ``(points,)``.
    y_mm: Py<PyArray1<f64>>,
}

impl Flank {
    pub(crate) fn new(py: Python<'_>, flank: &flankwatch_gear::Flank<'_>, points: usize) -> Self {
        let points: Vec<_> = flank.active_points(points - 1).collect();
        let column = |value: fn(&flankwatch_gear::FlankPoint) -> f64| {
            points.iter().map(value).collect::<Vec<_>>().into_pyarray(py).unbind()
        };
        Self {
            radius_mm: column(|point| point.radius_mm),
            depth_um: column(|point| point.depth_mm * 1e3),
            x_mm: column(|point| point.x_mm),
            y_mm: column(|point| point.y_mm),
        }
    }
}
