//! A comb of mesh harmonics in a spectrum, and how fine a spectrum has to be for one.

/// Shaft rates below this many bins are too low to separate a sideband from its carrier.
pub(super) const SHAFT_RESOLVED_BINS: f64 = 8.0;

/// Fewest bins from zero to the mesh frequency and between harmonics.
pub(super) const MESH_RESOLVED_BINS: f64 = 4.0;

/// Number of harmonics in which a mesh is searched and read.
pub(super) const HARMONICS: usize = 16;

/// A detected comb.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MeshComb {
    /// The mesh frequency in bins.
    pub(super) mesh: f64,
    /// Root mean square over the comb's lines of the ratio of amplitude to background (the noise's
    /// root-mean-square amplitude in one bin): about 1 in noise.
    pub(super) to_background: f64,
}
