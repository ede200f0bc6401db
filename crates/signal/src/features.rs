//! The feature vector for comparing measured and simulated records.

use serde::{Deserialize, Serialize};
use smol_str::format_smolstr;

use super::bearing_lines::EnvelopeLine;
use super::by_name::{ByName, Name};
use super::not_computed::NotComputed;
use super::record::OperatingPoint;

/// Identifier of the method behind the features. Only values with the same identifier are comparable.
pub const PREPROCESSING: &str = "speed-compensated-lines-2";

/// Features of one record by name. They are natural logarithms of amplitudes, so an unknown gain is an offset
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
/// If the speed fluctuates within the record, the phase fluctuation of the mesh is first removed from the
/// bins around each mesh harmonic, so a line smeared over many bins reads as at a constant speed.
///
/// All lines are narrow compared with the variation of a transmission path's frequency response, so the
/// path's gain at a line is an offset too. This is why each envelope covers a single harmonic: an envelope
/// over several harmonics depends on the path's phase between them. `ln_rms` and `ln_kurtosis` mix all
/// frequencies and have this property only for a path with a flat response.
///
/// Features that the record cannot provide are omitted from the map: a harmonic above half the sampling rate,
/// sidebands closer than 8 bins, a line that coincides with one of another mesh.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Features {
    /// Value by feature name, for example `ln_mesh_1`.
    #[cfg_attr(feature = "openapi", schema(value_type = std::collections::BTreeMap<String, f64>))]
    pub values: ByName<f64>,
    /// For each line feature (`ln_mesh_h`, `ln_sideband_h`, `ln_env_h`, and `ln_shaft_k` of the checks) the
    /// natural logarithm of its mean reading in local noise alone: the root-mean-square amplitude of noise in
    /// as many bins as the feature sums, from the median of the bins between the neighbouring lines. Omitted
    /// if there are too few such bins.
    ///
    /// A line is read at the highest peak within 1.5 bins, so in pure noise the value lies some tenths above
    /// this.
    #[serde(default)]
    #[cfg_attr(feature = "openapi", schema(value_type = std::collections::BTreeMap<String, f64>))]
    pub background: ByName<f64>,
    /// Natural logarithms of values that mesh wear hardly affects, by name. They separate wear from other
    /// causes.
    ///
    /// | name | natural logarithm of |
    /// | --- | --- |
    /// | `ln_floor_fhz`, f = … 500, 1000, 2000 … | the noise floor (from the median bin) of the octave around f, as a density: the record's unit over √Hz; the six highest octaves below 45 % of the sampling rate |
    /// | `ln_rest_fhz` | the same density from the root mean square of the bins outside the mesh harmonics and their sidebands |
    /// | `ln_band_fhz` | the same density from all bins, in a record without a mesh line |
    /// | `ln_shaft_k`, k = 1 … 3 | the amplitude that lies within 0.3 shaft rates of k times the shaft rate |
    /// | `ln_tooth_repeated_n`, n = 2, 8, 32, 128 | in averages of n turns, the part between the mesh harmonics, over the same part of half the difference between even and odd turns: 0 if there is only noise; the three largest n that the record fills |
    /// | `ln_tooth_worst_n` | the highest root mean square of that part over one tooth's pitch, over the median one |
    /// | `ln_tooth_kurtosis_n` | the square root of that part's kurtosis |
    ///
    /// Apart from their scatter, none depends on the length of the record.
    #[serde(default, skip_serializing_if = "ByName::is_empty")]
    #[cfg_attr(feature = "openapi", schema(value_type = std::collections::BTreeMap<String, f64>))]
    pub checks: ByName<f64>,
    /// The operating point: the speed given or found, and the torque if known.
    #[serde(default)]
    pub operating_point: OperatingPoint,
    /// Duration and sampling rate of the record.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub extent: Option<Extent>,
    /// Why the shaft speed found in the record is in doubt. In that case there are no mesh line features.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_doubt: Option<String>,
    /// Why a shaft speed that was given is in doubt. It is used nevertheless.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub given_speed_doubt: Option<String>,
    /// The strongest line of the envelope spectrum, if it stands out: for a record whose kurtosis exceeds 4,
    /// or for a machine with configured bearings.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub envelope_line: Option<EnvelopeLine>,
    /// Why the samples themselves are unusable: they are constant, clipped or have gaps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fault: Option<NotComputed>,
}

/// Duration and sampling rate of a record. Records that differ in these cannot always be compared.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Extent {
    /// Duration in seconds.
    pub seconds: f64,
    /// Sampling rate in hertz.
    pub sample_rate_hz: f64,
}

/// Two lines must be this many bins apart to be separable under the Hann window: their main lobes and one bin
/// between.
const MIN_SEPARATION_BINS: f64 = 5.0;

impl Extent {
    /// Returns the shortest duration in seconds at which the mesh lines of a shaft at this speed in hertz can
    /// be separated from their sidebands.
    pub fn min_seconds_to_separate_lines(shaft_speed_hz: f64) -> f64 {
        MIN_SEPARATION_BINS / shaft_speed_hz
    }
}

/// Lowest amplitude relative to the record's standard deviation. It lies below the rounding of 32-bit samples
/// and avoids the logarithm of zero.
const AMPLITUDE_FLOOR: f64 = 1e-9;

impl Features {
    /// Returns whether a mesh harmonic could be read.
    pub fn has_mesh(&self) -> bool {
        self.values.keys().any(|name| name.starts_with("ln_mesh_"))
    }

    /// Inserts one line feature: its `amplitude` and the noise amplitude in it, for a record with this
    /// standard `deviation`.
    pub(super) fn insert_line(&mut self, name: Name, amplitude: f64, noise: Option<f64>, deviation: f64) {
        let floor = AMPLITUDE_FLOOR * deviation;
        if let Some(noise) = noise {
            self.background.insert(name.clone(), noise.max(floor).ln());
        }
        self.values.insert(name, amplitude.max(floor).ln());
    }

    /// Inserts the check of one line of the shaft: its `amplitude` and that of `noise` alone.
    pub(super) fn insert_shaft_line(&mut self, order: usize, amplitude: f64, noise: f64, deviation: f64) {
        let name = format_smolstr!("ln_shaft_{order}");
        self.background.insert(name.clone(), noise.max(AMPLITUDE_FLOOR * deviation).ln());
        self.insert_check(name, amplitude, deviation);
    }

    /// Inserts one value that wear hardly affects.
    pub(super) fn insert_check(&mut self, name: Name, amplitude: f64, deviation: f64) {
        self.checks.insert(name, amplitude.max(AMPLITUDE_FLOOR * deviation).ln());
    }
}
