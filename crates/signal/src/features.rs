//! The feature vector that measured and simulated records are compared by.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::bearing_lines::EnvelopeLine;
use super::indicators::NotComputed;
use super::record::OperatingPoint;

/// Identifier of what the features are made by. Values are comparable only where it is the same.
pub const PREPROCESSING: &str = "steadied-lines-6";

/// Features of one record by name, each on a scale where an unknown gain is an offset (natural logarithms of
/// amplitudes) and changes relative to a healthy baseline are differences.
///
/// | name | natural logarithm of |
/// | --- | --- |
/// | `ln_mesh_h`, h = 1 … 16 | the amplitude of mesh harmonic h |
/// | `ln_sideband_h`, h = 1 … 4 | the root sum square of the amplitudes at h × mesh frequency ± 1 and ± 2 shaft rates |
/// | `ln_env_h`, h = 1 … 4 | the shaft-rate line in the envelope spectrum of the band of ± 2.5 shaft rates around mesh harmonic h: the part of the sidebands that modulates the amplitude |
/// | `ln_rms` | the root mean square, mean removed |
/// | `ln_kurtosis` | the kurtosis |
///
/// Where the speed wanders within the record, lines are read after the mesh phase's wander is taken out of
/// the bins around each mesh harmonic: a line that is smeared over many bins reads as at a constant speed.
///
/// All lines are narrow against what a transmission path does to a spectrum, so that the path's gain at that
/// frequency is an offset too. That is why the envelopes are those of single harmonics: a band over several
/// has lines that depend on the path's phase between them. `ln_rms` and `ln_kurtosis` mix all frequencies and
/// keep this property only for a path without colour.
///
/// A feature that the record cannot give (a harmonic above half the sampling rate, sidebands closer than 8
/// bins, a line where one of another mesh lies) is missing from the map.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Features {
    /// Value by feature name, for example `ln_mesh_1`.
    pub values: BTreeMap<String, f64>,
    /// For each line feature (`ln_mesh_h`, `ln_sideband_h`, `ln_env_h`) the natural logarithm of what local
    /// noise alone would read on average: the root-mean-square amplitude of noise in as many bins as the
    /// feature adds up, from the median of the bins between the lines beside it. Missing where too few such
    /// bins are there.
    ///
    /// A line is read at the highest peak within 1.5 bins, so that in pure noise the value lies some tenths
    /// above this.
    #[serde(default)]
    pub background: BTreeMap<String, f64>,
    /// Values that wear of the mesh hardly moves, by name, as natural logarithms too: they tell wear from
    /// what is not wear.
    ///
    /// | name | natural logarithm of |
    /// | --- | --- |
    /// | `ln_floor_fhz`, f = … 500, 1000, 2000 … | the noise floor (from the median bin) of the octave around f, as a density: the record's unit over √Hz; the five highest octaves below 45 % of the sampling rate |
    /// | `ln_rest_fhz` | the same of the root mean square bin outside the mesh harmonics and their sidebands |
    /// | `ln_band_fhz` | the same of all bins, in a record without a mesh line |
    /// | `ln_shaft_k`, k = 1 … 3 | the amplitude that lies within 0.3 shaft rates of k times the shaft rate |
    /// | `ln_tooth_repeated_n`, n = 2, 8, 32, 128 | in averages of n turns, the part that lies between the mesh harmonics, over the same part of half the difference between even and odd turns: 0 where nothing but noise is there; the three largest n that the record fills |
    /// | `ln_tooth_worst_n` | the highest root mean square of that part over one tooth's pitch, over the median one |
    /// | `ln_tooth_kurtosis_n` | the square root of that part's kurtosis |
    ///
    /// None depends on how long the record is, but for its scatter.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub checks: BTreeMap<String, f64>,
    /// Where the machine stood: the speed given or found, the torque as far as it is known.
    #[serde(default)]
    pub operating_point: OperatingPoint,
    /// How long the record is, and how densely sampled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub extent: Option<Extent>,
    /// Why the shaft speed that was found in the record is in doubt: then there are no lines of the mesh.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_doubt: Option<String>,
    /// The strongest line of the envelope spectrum, where it stands out: of a record whose kurtosis exceeds 4,
    /// or of a machine whose bearings are described.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub envelope_line: Option<EnvelopeLine>,
    /// What is wrong with the samples themselves: they do not vary, are clipped, or have gaps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fault: Option<NotComputed>,
}

/// How long a record is, and how densely sampled: records that differ in this cannot always be compared.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Extent {
    /// Length in seconds.
    pub seconds: f64,
    /// Samples per second in hertz.
    pub sample_rate_hz: f64,
}

/// Under the Hann window two lines are read apart where they are so many bins from each other: their main
/// lobes and a bin between.
const LINES_APART_BINS: f64 = 5.0;

impl Extent {
    /// How long a record has to be for the mesh lines of a shaft at this speed in hertz to be read apart from
    /// their sidebands.
    pub fn seconds_apart(shaft_speed_hz: f64) -> f64 {
        LINES_APART_BINS / shaft_speed_hz
    }
}

/// The least amplitude as a part of the record's deviation: rounding of 32-bit samples lies above it, and no
/// logarithm of zero comes out.
const AMPLITUDE_FLOOR: f64 = 1e-9;

impl Features {
    /// Whether a harmonic of the mesh could be read.
    pub fn has_mesh(&self) -> bool {
        self.values.keys().any(|name| name.starts_with("ln_mesh_"))
    }

    /// Puts down one line feature: its `amplitude` and that of the noise in it, for a record of this
    /// `deviation`.
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
