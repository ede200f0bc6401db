//! Values of a record that wear of the mesh hardly moves: they tell wear from other faults and from faults of the sensor.

use super::features::Features;
use super::line::{MAIN_LOBE_BINS, background, noise_amplitude, read_line, search_reach};
use super::record_spectrum::RecordSpectrum;
use super::speed::MeshContext;

/// Bands of equal ratio between the lowest frequency and half the sampling rate.
const BANDS: usize = 4;

/// The lowest band begins at this part of half the sampling rate.
const LOWEST_PART: f64 = 0.02;

/// The upper end leaves out where anti-aliasing filters act.
const HIGHEST_PART: f64 = 0.9;

/// Bins that a band's noise floor is taken from.
const FLOOR_BINS: usize = 400;

/// Orders of the shaft that are read.
const SHAFT_ORDERS: usize = 3;

/// Shaft lines are read on top of this many times the noise beside them: what noise does to a line that is not there says nothing.
const SHAFT_FLOOR: f64 = 3.0;

/// What belongs to a mesh harmonic, in shaft rates, and as a part of its frequency where the speed wanders.
const COMB_SHAFTS: f64 = 3.5;
const COMB_WANDER: f64 = 0.006;

/// Puts down the noise floors, the energy beside the combs of this mesh and of others, and the shaft's own lines; of a record without a `mesh`
/// (its place in bins and what is known of it) the floors and all energy of the bands.
pub(super) fn insert_checks(work: &mut RecordSpectrum, mesh: Option<(f64, &MeshContext)>, deviation: f64, features: &mut Features) {
    let RecordSpectrum { amplitude, sorting, .. } = work;
    let highest = amplitude.len().saturating_sub(1) as f64;
    let edge = |i: usize| highest * LOWEST_PART * (HIGHEST_PART / LOWEST_PART).powf(i as f64 / BANDS as f64);
    for band in 0..BANDS {
        let (first, last) = (edge(band).ceil() as usize, edge(band + 1).floor() as usize);
        if last < first + 16 || last >= amplitude.len() {
            continue;
        }
        let bins = &amplitude[first..=last];
        sorting.clear();
        sorting.extend(bins.iter().step_by(bins.len().div_ceil(FLOOR_BINS)));
        if let Some(floor) = noise_amplitude(sorting) {
            features.insert_check(format!("ln_floor_{}", band + 1), floor, deviation);
        }
        let Some((mesh_bins, mesh)) = mesh else {
            let energy: f64 = amplitude[first..=last].iter().map(|a| a * a).sum();
            let whole = (energy / (last - first + 1) as f64).sqrt();
            features.insert_check(format!("ln_band_{}", band + 1), whole, deviation);
            continue;
        };
        if let Some(rest) = beside_combs(amplitude, [first, last], mesh_bins, mesh) {
            features.insert_check(format!("ln_rest_{}", band + 1), rest, deviation);
        }
    }
    let Some((mesh_bins, mesh)) = mesh else { return };
    let shaft_bins = mesh_bins / f64::from(mesh.teeth);
    for order in 1..=SHAFT_ORDERS {
        let position = order as f64 * shaft_bins;
        let reach = search_reach(position) + 2.0 * MAIN_LOBE_BINS;
        if mesh.others.lie_at(order as f64, reach / shaft_bins) {
            continue;
        }
        let noise = background(amplitude, position, Some(shaft_bins), 2.0 * shaft_bins, sorting);
        if let (Some(line), Some(noise)) = (read_line(amplitude, position), noise) {
            features.insert_check(format!("ln_shaft_{order}"), line.amplitude.hypot(SHAFT_FLOOR * noise), deviation);
        }
    }
}

/// Root mean square of the bins between what belongs to harmonics of any mesh; `None` where the band has too few of them.
fn beside_combs(amplitude: &[f64], [first, last]: [usize; 2], mesh_bins: f64, mesh: &MeshContext) -> Option<f64> {
    let shaft_bins = mesh_bins / f64::from(mesh.teeth);
    let (mut energy, mut count) = (0.0, 0_usize);
    let first_order = (first as f64 / mesh_bins).floor() as usize;
    let last_order = (last as f64 / mesh_bins).ceil() as usize;
    for order in first_order..last_order {
        let (low, high) = (order as f64 * mesh_bins, (order + 1) as f64 * mesh_bins);
        let clear = |centre: f64| COMB_SHAFTS * shaft_bins + COMB_WANDER * centre;
        let from = ((low + clear(low)).ceil() as usize).max(first);
        let to = ((high - clear(high)).floor() as usize).min(last);
        if from < to {
            if mesh.others.is_empty() {
                energy += amplitude[from..=to].iter().map(|a| a * a).sum::<f64>();
                count += to + 1 - from;
                continue;
            }
            let beside = (from..=to).filter(|bin| !mesh.others.hold(*bin as f64 / shaft_bins, COMB_WANDER));
            beside.for_each(|bin| {
                energy += amplitude[bin] * amplitude[bin];
                count += 1;
            });
        }
    }
    (count >= 16).then(|| (energy / count as f64).sqrt())
}
