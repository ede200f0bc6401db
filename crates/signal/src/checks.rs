//! Values of a record that mesh wear hardly affects. They separate wear from other faults and from sensor
//! faults.

use std::f64::consts::SQRT_2;

use smol_str::format_smolstr;

use super::comb::SHAFT_RESOLVED_BINS;
use super::features::Features;
use super::line::{MAIN_LOBE_BINS, background, noise_amplitude};
use super::mesh_context::MeshContext;
use super::other_meshes::OtherMeshes;
use super::record_spectrum::RecordSpectrum;
use super::spectrum::HANN_BANDWIDTH_BINS;
use super::sums::sum_of;

/// Number of octaves, counted from the highest one that fits below half the sampling rate. They are those of
/// IEC 61260 with base 2, so that records with other sampling rates share them.
const OCTAVES: usize = 6;

/// For a gear, octaves below the mesh frequency are skipped, but at least this many are read: below the mesh
/// frequency lie the shaft's own lines, and the little noise there varies with everything.
const MIN_OCTAVES: usize = 3;

/// Highest frequency as a fraction of half the sampling rate: anti-aliasing filters act above.
const MAX_NYQUIST_FRACTION: f64 = 0.9;

/// Fewest bins of an octave.
const MIN_BINS: usize = 16;

/// Number of bins used for a band's noise floor.
const FLOOR_BINS: usize = 400;

/// Number of shaft orders that are read.
const SHAFT_ORDERS: usize = 3;

/// A shaft line comprises all bins within this fraction of the shaft rate to either side, so that its noise
/// does not depend on the record's length.
const SHAFT_REACH: f64 = 0.3;

/// A floor of this many times the expected noise is added: fluctuations of a missing line carry no
/// information.
const SHAFT_FLOOR: f64 = 2.0;

/// Half-width of a mesh harmonic with its sidebands: in shaft rates, plus a fraction of its frequency for
/// speed fluctuation.
const COMB_SHAFTS: f64 = 3.5;
const COMB_TOLERANCE: f64 = 0.006;

/// Inserts the noise floors and the energy outside the combs of this mesh and of others; for a record without
/// a `mesh` (its position in bins and its context) the floors and the whole energy of the octaves. Noise is
/// inserted as a density, so that it does not depend on the record's length.
pub(super) fn insert_checks(
    work: &mut RecordSpectrum,
    resolution_hz: f64,
    mesh: Option<(f64, &MeshContext)>,
    deviation: f64,
    features: &mut Features,
) {
    let RecordSpectrum { amplitude, sorting, .. } = work;
    // The squared amplitude over this is a density: half of it is a mean square, in 1.5 bins.
    let to_density = (2.0 * HANN_BANDWIDTH_BINS * resolution_hz).sqrt().recip();
    let lowest_hz = mesh.map_or(0.0, |(mesh_bins, mesh)| {
        let nominal_hz = f64::from(mesh.teeth) * mesh.nominal_shaft_speed_hz;
        if nominal_hz > 0.0 { nominal_hz } else { mesh_bins * resolution_hz }
    });
    for Octave { centre_hz, bins: [first, last] } in octaves(amplitude.len(), resolution_hz, lowest_hz) {
        let bins = &amplitude[first..=last];
        sorting.clear();
        sorting.extend(bins.iter().step_by(bins.len().div_ceil(FLOOR_BINS)));
        if let Some(floor) = noise_amplitude(sorting) {
            features.insert_check(
                format_smolstr!("ln_floor_{centre_hz:.0}hz"),
                floor * to_density,
                deviation,
            );
        }
        let Some((mesh_bins, mesh)) = mesh else {
            let energy: f64 = bins.iter().map(|a| a * a).sum();
            let whole = (energy / bins.len() as f64).sqrt();
            features.insert_check(format_smolstr!("ln_band_{centre_hz:.0}hz"), whole * to_density, deviation);
            continue;
        };
        if let Some(rest) = rms_outside_combs(amplitude, [first, last], mesh_bins, mesh) {
            features.insert_check(format_smolstr!("ln_rest_{centre_hz:.0}hz"), rest * to_density, deviation);
        }
    }
}

/// Inserts the lines of a shaft.
pub(super) fn insert_shaft_lines(
    work: &mut RecordSpectrum,
    shaft_bins: f64,
    others: OtherMeshes,
    deviation: f64,
    features: &mut Features,
) {
    let RecordSpectrum { amplitude, sorting, .. } = work;
    if shaft_bins < SHAFT_RESOLVED_BINS {
        return;
    }
    for order in 1..=SHAFT_ORDERS {
        let position = order as f64 * shaft_bins;
        let reach = SHAFT_REACH * shaft_bins;
        if others.has_line_near(order as f64, SHAFT_REACH + 2.0 * MAIN_LOBE_BINS / shaft_bins) {
            continue;
        }
        let (first, last) = ((position - reach).ceil() as usize, (position + reach).floor() as usize);
        let Some(bins) = amplitude.get(first..=last) else {
            return;
        };
        let squares: f64 = bins.iter().map(|a| a * a).sum();
        let count = bins.len() as f64;
        let Some(noise) = background(amplitude, position, Some(shaft_bins), 2.0 * shaft_bins, sorting) else {
            continue;
        };
        let in_noise = noise * noise * count;
        let floor = SHAFT_FLOOR * SHAFT_FLOOR * in_noise;
        let amplitude = |squares: f64| ((squares + floor) / HANN_BANDWIDTH_BINS).sqrt();
        features.insert_shaft_line(order, amplitude(squares), amplitude(in_noise), deviation);
    }
}

/// One octave of a spectrum.
#[derive(Debug, Clone, Copy)]
struct Octave {
    /// Centre frequency, 1000 Hz times a power of two.
    centre_hz: f64,
    /// First and last bin.
    bins: [usize; 2],
}

/// Returns the highest octaves within a spectrum of `bins` bins that end above `lowest_hz`.
fn octaves(bins: usize, resolution_hz: f64, lowest_hz: f64) -> impl Iterator<Item = Octave> {
    let highest_hz = MAX_NYQUIST_FRACTION * bins.saturating_sub(1) as f64 * resolution_hz;
    let top = (highest_hz / 1000.0 / SQRT_2).log2().floor();
    let octave = move |below: usize| {
        let centre_hz = 1000.0 * (top - below as f64).exp2();
        let edge = |hz: f64| (hz / resolution_hz).ceil() as usize;
        let (first, end) = (edge(centre_hz / SQRT_2).max(1), edge(centre_hz * SQRT_2));
        let is_needed = below < MIN_OCTAVES || centre_hz * SQRT_2 > lowest_hz;
        (is_needed && end <= bins && end >= first + MIN_BINS)
            .then(|| Octave { centre_hz, bins: [first, end - 1] })
    };
    (0..OCTAVES).filter_map(octave)
}

/// Returns the root mean square of the bins that belong to no harmonic of any mesh, or `None` if there are
/// fewer than 16.
fn rms_outside_combs(
    amplitude: &[f64],
    [first, last]: [usize; 2],
    mesh_bins: f64,
    mesh: &MeshContext,
) -> Option<f64> {
    let shaft_bins = mesh_bins / f64::from(mesh.teeth);
    let (mut energy, mut count) = (0.0, 0_usize);
    let first_order = (first as f64 / mesh_bins).floor() as usize;
    let last_order = (last as f64 / mesh_bins).ceil() as usize;
    for order in first_order..last_order {
        let (low, high) = (order as f64 * mesh_bins, (order + 1) as f64 * mesh_bins);
        let clear = |centre: f64| COMB_SHAFTS * shaft_bins + COMB_TOLERANCE * centre;
        let from = ((low + clear(low)).ceil() as usize).max(first);
        let to = ((high - clear(high)).floor() as usize).min(last);
        if from < to {
            if mesh.others.is_empty() {
                energy += sum_of(&amplitude[from..=to], |a| a * a);
                count += to + 1 - from;
                continue;
            }
            let beside =
                (from..=to).filter(|bin| !mesh.others.contains(*bin as f64 / shaft_bins, COMB_TOLERANCE));
            beside.for_each(|bin| {
                energy += amplitude[bin] * amplitude[bin];
                count += 1;
            });
        }
    }
    (count >= 16).then(|| (energy / count as f64).sqrt())
}
