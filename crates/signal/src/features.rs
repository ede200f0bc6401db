//! The feature vector that measured and simulated records are compared by.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::indicators::Absence;
use super::record::OperatingPoint;

/// Identifier of what the features are made by. Values are comparable only where it is the same.
pub const PREPROCESSING: &str = "steadied-lines-4";

/// Features of one record by name, each on a scale where an unknown gain is an offset (natural logarithms of amplitudes)
/// and changes relative to a healthy baseline are differences.
///
/// | name | natural logarithm of |
/// | --- | --- |
/// | `ln_mesh_h`, h = 1 … 16 | the amplitude of mesh harmonic h |
/// | `ln_sideband_h`, h = 1 … 4 | the root sum square of the amplitudes at h × mesh frequency ± 1 and ± 2 shaft rates |
/// | `ln_env_h`, h = 1 … 4 | the shaft-rate line in the envelope spectrum of the band of ± 2.5 shaft rates around mesh harmonic h: the part of the sidebands that modulates the amplitude |
/// | `ln_rms` | the root mean square, mean removed |
/// | `ln_kurtosis` | the kurtosis |
///
/// Where the speed wanders within the record, lines are read after the mesh phase's wander is taken out of the bins around each mesh
/// harmonic: a line that is smeared over many bins reads as at a constant speed.
///
/// All lines are narrow against what a transmission path does to a spectrum, so that the path's gain at that frequency is an offset
/// too. That is why the envelopes are those of single harmonics: a band over several has lines that depend on the path's phase
/// between them. `ln_rms` and `ln_kurtosis` mix all frequencies and keep this property only for a path without colour.
///
/// A feature that the record cannot give (a harmonic above half the sampling rate, sidebands closer than 8 bins, a line where one of another
/// mesh lies) is missing from the map.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Features {
    /// Value by feature name, for example `ln_mesh_1`.
    pub values: BTreeMap<String, f64>,
    /// For each line feature (`ln_mesh_h`, `ln_sideband_h`, `ln_env_h`) the natural logarithm of what local noise alone would read on average:
    /// the root-mean-square amplitude of noise in as many bins as the feature adds up, from the median of the bins between the lines
    /// beside it. Missing where too few such bins are there.
    ///
    /// A line is read at the highest peak within 1.5 bins, so that in pure noise the value lies some tenths above this.
    #[serde(default)]
    pub background: BTreeMap<String, f64>,
    /// Values that wear of the mesh hardly moves, by name, as natural logarithms too: they tell wear from what is not wear.
    ///
    /// | name | natural logarithm of |
    /// | --- | --- |
    /// | `ln_floor_b`, b = 1 … 4 | the noise floor (from the median bin) of the band b of four of equal ratio from 2 % to 90 % of half the sampling rate |
    /// | `ln_rest_b`, b = 1 … 4 | the root mean square bin of the band outside the mesh harmonics and their sidebands |
    /// | `ln_band_b`, b = 1 … 4 | the root mean square bin of the band, in a record without a mesh line |
    /// | `ln_shaft_k`, k = 1 … 3 | the amplitude at k times the shaft rate, three times the noise beside it added by squares |
    /// | `ln_tooth_repeated` | the part of the mean turn that lies between the mesh harmonics, over the same part of half the difference between even and odd turns: 0 where nothing but noise is there |
    /// | `ln_tooth_worst` | the highest root mean square of that part over one tooth's pitch, over the median one |
    /// | `ln_tooth_kurtosis` | the square root of that part's kurtosis |
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub checks: BTreeMap<String, f64>,
    /// Where the machine stood: the speed given or found, the torque as far as it is known.
    #[serde(default)]
    pub operating_point: OperatingPoint,
    /// What is wrong with the samples themselves: they do not vary, are clipped, or have gaps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fault: Option<Absence>,
}

/// The least amplitude as a part of the record's deviation: rounding of 32-bit samples lies above it, and no logarithm of
/// zero comes out.
const AMPLITUDE_FLOOR: f64 = 1e-9;

impl Features {
    /// Whether a harmonic of the mesh could be read.
    pub fn has_mesh(&self) -> bool {
        self.values.keys().any(|name| name.starts_with("ln_mesh_"))
    }

    /// Puts down one line feature: its `amplitude` and that of the noise in it, for a record of this `deviation`.
    pub(super) fn insert_line(&mut self, name: String, amplitude: f64, noise: Option<f64>, deviation: f64) {
        let floor = AMPLITUDE_FLOOR * deviation;
        if let Some(noise) = noise {
            self.background.insert(name.clone(), noise.max(floor).ln());
        }
        self.values.insert(name, amplitude.max(floor).ln());
    }

    /// Puts down one value that wear hardly moves.
    pub(super) fn insert_check(&mut self, name: String, amplitude: f64, deviation: f64) {
        self.checks.insert(name, amplitude.max(AMPLITUDE_FLOOR * deviation).ln());
    }
}
