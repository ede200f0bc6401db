//! The envelope spectrum of a record: the requested band and its highest lines.

use std::str::FromStr;

use serde::Serialize;

use crate::signal::{BandError, EnvelopeBand, EnvelopeSearch, Spectrum};

/// The band of `--envelope`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum EnvelopeArg {
    /// The band or search that the asset describes.
    Asset,
    Search(EnvelopeSearch),
    /// Lower and upper limit in Hz.
    Hertz([f64; 2]),
}

impl FromStr for EnvelopeArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "asset" => return Ok(Self::Asset),
            "mesh" => return Ok(Self::Search(EnvelopeSearch::MeshHarmonic)),
            "kurtogram" => return Ok(Self::Search(EnvelopeSearch::Kurtogram)),
            _ => {}
        }
        let band = text
            .split_once(',')
            .and_then(|(low, high)| Some([low.trim().parse().ok()?, high.trim().parse().ok()?]));
        match band {
            Some([low, high]) if low >= 0.0 && low < high && f64::is_finite(high) => {
                Ok(Self::Hertz([low, high]))
            }
            _ => {
                Err("expected asset, mesh, kurtogram, or two frequencies in hertz as in 2000,4000".to_owned())
            }
        }
    }
}

/// Number of spectral lines that are printed, the highest ones.
const ENVELOPE_LINES: usize = 8;

/// The band and the highest lines of a record's envelope spectrum.
#[derive(Debug, Serialize)]
pub(super) struct AnalyzedEnvelope {
    #[serde(flatten)]
    pub(super) band: EnvelopeBand,
    /// The highest lines, in descending order.
    pub(super) lines: Vec<EnvelopeLine>,
    /// Why the spectrum of this band could not be computed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) absent: Option<String>,
}

/// One line of an envelope spectrum.
#[derive(Debug, Serialize)]
pub(super) struct EnvelopeLine {
    pub(super) frequency_hz: f64,
    pub(super) amplitude: f64,
}

impl AnalyzedEnvelope {
    pub(super) fn new(band: EnvelopeBand, spectrum: &Result<Spectrum, BandError>) -> Self {
        let lines = spectrum.as_ref().map_or_else(
            |_| Vec::new(),
            |spectrum| {
                let amplitude = &spectrum.amplitude;
                // The first two bins hold the window's leakage of the mean.
                let mut peaks: Vec<usize> = (2..amplitude.len().saturating_sub(1))
                    .filter(|&bin| {
                        amplitude[bin] > amplitude[bin - 1] && amplitude[bin] >= amplitude[bin + 1]
                    })
                    .collect();
                peaks.sort_by(|&a, &b| amplitude[b].total_cmp(&amplitude[a]));
                peaks.truncate(ENVELOPE_LINES);
                let line = |bin: usize| EnvelopeLine {
                    frequency_hz: spectrum.frequency_hz(bin),
                    amplitude: amplitude[bin],
                };
                peaks.into_iter().map(line).collect()
            },
        );
        Self { band, lines, absent: spectrum.as_ref().err().map(ToString::to_string) }
    }
}
