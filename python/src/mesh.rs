//! Results of the gear model as arrays.

use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;

/// Stiffness and transmission error over one mesh period.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct MeshCycle {
    phi1_rad: Py<PyArray1<f64>>,
    phi2_rad: Py<PyArray1<f64>>,
    stiffness_n_per_m: Py<PyArray1<f64>>,
    uste_rad: Py<PyArray1<f64>>,
    pairs_in_contact: Py<PyArray1<u32>>,
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

/// Contact points and rotations of one pair of teeth.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct ToothContact {
    alpha1_rad: Py<PyArray1<f64>>,
    alpha1_prime_rad: Py<PyArray1<f64>>,
    phi1_rad: Py<PyArray1<f64>>,
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
    radius_mm: Py<PyArray1<f64>>,
    depth_um: Py<PyArray1<f64>>,
    x_mm: Py<PyArray1<f64>>,
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
