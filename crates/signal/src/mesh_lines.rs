//! The lines of a mesh in one record: harmonics, sidebands and their envelopes.

use serde::Serialize;
use smol_str::format_smolstr;

use super::comb::SHAFT_RESOLVED_BINS;
use super::features::Features;
use super::line::{LineReading, MAIN_LOBE_BINS, background, fits, read_line, read_mesh_line, search_reach};
use super::mesh_context::MeshContext;
use super::other_meshes::OtherMeshes;
use super::record_spectrum::RecordSpectrum;

/// Mesh harmonics whose sidebands and envelopes are features.
const SIDEBAND_HARMONICS: usize = 4;

/// Number of sidebands on each side of a harmonic.
const SIDEBANDS: usize = 2;

/// Half-width of the features' envelope band around a mesh harmonic, in shaft rates.
const FEATURE_BAND_SHAFTS: f64 = 2.5;

/// One measured mesh harmonic.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct MeshLine {
    /// Its order h, from 1.
    pub order: u32,
    /// Its frequency in hertz, interpolated between bins.
    pub frequency_hz: f64,
    /// Its amplitude (peak) in the record's unit.
    pub amplitude: f64,
}

/// Positions of one record's mesh lines, in bins.
#[derive(Debug, Clone, Copy)]
pub(super) struct MeshPositions {
    mesh_bins: f64,
    /// The shaft rate, if the record resolves it.
    shaft_bins: Option<f64>,
    teeth: f64,
    others: OtherMeshes,
}

impl MeshPositions {
    pub(super) fn new(mesh_bins: f64, mesh: &MeshContext) -> Self {
        let teeth = f64::from(mesh.teeth);
        let shaft_bins = mesh_bins / teeth;
        Self {
            mesh_bins,
            shaft_bins: (shaft_bins >= SHAFT_RESOLVED_BINS).then_some(shaft_bins),
            teeth,
            others: mesh.others,
        }
    }

    /// Returns whether the line `sideband` shaft rates beside mesh harmonic `order` belongs to this mesh
    /// alone: no line of another known mesh coincides with it.
    pub(super) fn is_own(&self, order: f64, sideband: f64) -> bool {
        if self.others.is_empty() {
            return true;
        }
        let shaft_orders = order * self.teeth + sideband;
        let bins_per_order = self.mesh_bins / self.teeth;
        // The search range plus the main lobes of both lines.
        let reach = search_reach(shaft_orders * bins_per_order) + 2.0 * MAIN_LOBE_BINS;
        !self.others.has_line_near(shaft_orders, reach / bins_per_order)
    }

    /// Reads mesh harmonic `order` and the noise in one bin beside it; `None` unless it lies below half the
    /// sampling rate.
    pub(super) fn read(&self, work: &mut RecordSpectrum, order: f64) -> Option<(LineReading, Option<f64>)> {
        let position = order * self.mesh_bins;
        let noise = self.noise(work, order);
        let reach = 0.4 * self.shaft_bins.unwrap_or(SHAFT_RESOLVED_BINS);
        read_mesh_line(&work.amplitude, position, reach, noise).map(|line| (line, noise))
    }

    fn noise(&self, work: &mut RecordSpectrum, order: f64) -> Option<f64> {
        let reach = 0.5 * self.mesh_bins;
        background(&work.amplitude, order * self.mesh_bins, self.shaft_bins, reach, &mut work.sorting)
    }

    fn has_own_sidebands(&self, order: usize) -> bool {
        let reach = SIDEBANDS as i32;
        (-reach..=reach).all(|sideband| self.is_own(order as f64, f64::from(sideband)))
    }

    pub(super) fn sidebands(&self, work: &mut RecordSpectrum, deviation: f64, features: &mut Features) {
        let Some(shaft_bins) = self.shaft_bins else { return };
        for order in (1..=SIDEBAND_HARMONICS).filter(|order| self.has_own_sidebands(*order)) {
            let centre = order as f64 * self.mesh_bins;
            let sidebands = (1..=SIDEBANDS)
                .flat_map(|k| [centre - k as f64 * shaft_bins, centre + k as f64 * shaft_bins]);
            let energy: Option<f64> = sidebands
                .map(|position| {
                    read_line(&work.amplitude, position).map(|line| line.amplitude * line.amplitude)
                })
                .sum();
            let Some(energy) = energy else { return };
            let noise = self.noise(work, order as f64).map(|noise| noise * (2.0 * SIDEBANDS as f64).sqrt());
            features.insert_line(format_smolstr!("ln_sideband_{order}"), energy.sqrt(), noise, deviation);
        }
    }

    pub(super) fn envelopes(&self, work: &mut RecordSpectrum, deviation: f64, features: &mut Features) {
        let Some(shaft_bins) = self.shaft_bins else { return };
        let reach = FEATURE_BAND_SHAFTS * shaft_bins;
        for order in (1..=SIDEBAND_HARMONICS).filter(|order| self.has_own_sidebands(*order)) {
            let centre = order as f64 * self.mesh_bins;
            if centre <= reach + 1.0 || !fits(centre + reach, work.bins.len()) {
                return;
            }
            let band = [(centre - reach).ceil() as usize, (centre + reach).floor() as usize];
            work.envelope.compute(&work.bins, work.length, band, &mut work.transforms);
            let Some(line) = read_line(&work.envelope.amplitude, shaft_bins) else {
                return;
            };
            let noise =
                background(&work.envelope.amplitude, shaft_bins, Some(shaft_bins), reach, &mut work.sorting);
            features.insert_line(format_smolstr!("ln_env_{order}"), line.amplitude, noise, deviation);
        }
    }
}
