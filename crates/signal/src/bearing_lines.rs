//! The lines of rolling bearings in an envelope spectrum, and the strongest line of it. Positions are in
//! bins.

use serde::{Deserialize, Serialize};
use smallvec::SmallVec;

use super::bearing::{Bearing, BearingLine};
use super::indicators::Indicators;
use super::line::{DETECTION_RATIO, LineReading, MAIN_LOBE_BINS, fits, noise_amplitude, read_line};
use super::not_computed::NotComputed;

/// Number of harmonics of a fault frequency that are summed.
const HARMONICS: usize = 3;

/// Rolling elements slip: a line lies within this fraction of its geometric position.
const SLIP: f64 = 0.02;

/// Fewest bins from zero to a line.
const RESOLVED_BINS: f64 = 4.0;

/// Harmonics of a comb are excluded as lines of others only if they are at least this many bins apart.
const MIN_SPACING_BINS: f64 = 8.0;

/// Half-width of a line: its main lobe, and a fraction of its position for speed fluctuation and slip.
const LINE_REACH_BINS: f64 = MAIN_LOBE_BINS + 0.5;
const SHAFT_TOLERANCE: f64 = 5e-4;
const BEARING_TOLERANCE: f64 = 3e-3;

/// A bearing's line stands out, and is excluded from the other bearings' lines, if its first harmonic and all
/// together reach this ratio to the background. A higher harmonic alone may be one of another line.
const MIN_CLAIM_RATIO: f64 = 3.0;

/// Bins on each side of a line's window used for its background: minimum and maximum.
const BACKGROUND_BINS: [f64; 2] = [8.0, 32.0];

/// Fewest bins of a background.
const MIN_BACKGROUND_BINS: usize = 8;

/// Bins per background block in the search for the strongest line.
const BLOCK_BINS: usize = 64;

/// The strongest line is attributed to one of the first this many harmonics of a bearing's frequency or of
/// the shaft rate.
const MAX_SOURCE_HARMONIC: u32 = 5;

/// The strongest line of a record's envelope spectrum, if it stands out from the background.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct EnvelopeLine {
    /// Frequency in hertz.
    pub frequency_hz: f64,
    /// Ratio of its amplitude to that of the noise around it.
    pub to_background: f64,
    /// The band of the envelope, in hertz.
    pub band_hz: [f64; 2],
    /// The known source at that frequency.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<LineSource>,
}

/// The source of a line in an envelope spectrum.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum LineSource {
    /// A configured bearing.
    Bearing {
        /// The bearing's name.
        bearing: String,
        /// The fault frequency.
        line: BearingLine,
        /// The harmonic of the fault frequency.
        harmonic: u32,
    },
    /// The reference shaft.
    Shaft {
        /// The harmonic of its rate.
        harmonic: u32,
    },
}

impl EnvelopeLine {
    /// Describes the line in one sentence.
    pub fn words(&self) -> String {
        let source = match &self.source {
            Some(LineSource::Bearing { bearing, line, harmonic }) => {
                let (part, name) = (line.part(), line.name().to_uppercase());
                format!(", the {part} of bearing {bearing} ({harmonic} × {name})")
            }
            Some(LineSource::Shaft { harmonic: 1 }) => ", the shaft's rate".to_owned(),
            Some(LineSource::Shaft { harmonic }) => format!(", {harmonic} times the shaft's rate"),
            None => String::new(),
        };
        let [low, high] = self.band_hz;
        format!(
            "the envelope's strongest line is at {:.1} Hz{source}, {:.1} times its background, in the band from {low:.0} to {high:.0} Hz",
            self.frequency_hz, self.to_background
        )
    }
}

/// An envelope spectrum and the shaft speed.
pub(super) struct EnvelopeLines<'a> {
    /// Hann amplitudes.
    pub(super) amplitude: &'a [f64],
    /// Bin spacing in hertz.
    pub(super) resolution_hz: f64,
    /// The shaft's rotational frequency in hertz and its relative uncertainty.
    pub(super) shaft: Option<(f64, f64)>,
}

/// The harmonics of a line.
#[derive(Debug, Clone, Copy)]
struct Comb {
    spacing: f64,
    tolerance: f64,
}

/// A bearing's line that stands out from the background.
#[derive(Debug, Clone, Copy)]
pub(super) struct DetectedLine<'a> {
    bearing: &'a str,
    line: BearingLine,
    /// Position of its first harmonic.
    position: f64,
}

/// A measured bearing line.
#[derive(Debug, Clone, Copy)]
struct Reading {
    /// Root sum square of its harmonic amplitudes.
    amplitude: f64,
    /// Root mean square of their ratios to the background.
    to_background: f64,
    /// The ratio of the first harmonic alone.
    first_to_background: f64,
    /// Position of the first harmonic.
    position: f64,
}

impl Reading {
    fn stands_out(&self) -> bool {
        self.first_to_background.min(self.to_background) >= MIN_CLAIM_RATIO
    }
}

impl Comb {
    /// Returns whether a bin belongs to one of the harmonics.
    fn contains(self, bin: usize) -> bool {
        let bin = bin as f64;
        let harmonic = (bin / self.spacing).round();
        harmonic > 0.0 && (bin - harmonic * self.spacing).abs() <= LINE_REACH_BINS + self.tolerance * bin
    }
}

impl EnvelopeLines<'_> {
    /// Inserts the indicators of each bearing's lines, in descending order of their ratio to the background.
    /// Bins of a detected line and its harmonics are excluded from the others'. Returns the detected lines.
    pub(super) fn indicate<'b>(
        &self,
        bearings: &'b [Bearing],
        scratch: &mut Vec<f64>,
        indicators: &mut Indicators,
    ) -> Vec<DetectedLine<'b>> {
        let mut pending: Vec<(&Bearing, BearingLine)> =
            bearings.iter().flat_map(|bearing| BearingLine::ALL.map(|line| (bearing, line))).collect();
        let (mut claimed, mut detected) = (Vec::new(), Vec::new());
        while !pending.is_empty() {
            let readings: Vec<Result<Reading, NotComputed>> =
                pending.iter().map(|(bearing, line)| self.read(bearing, *line, &claimed, scratch)).collect();
            let standing_out = readings
                .iter()
                .enumerate()
                .filter_map(|(index, reading)| Some((index, reading.ok().filter(Reading::stands_out)?)));
            let highest = standing_out.max_by(|(_, a), (_, b)| a.to_background.total_cmp(&b.to_background));
            let settled: Vec<usize> = match highest {
                Some((index, _)) => vec![index],
                None => (0..pending.len()).collect(),
            };
            for index in settled {
                let (bearing, line) = pending[index];
                let [name, ratio] = bearing.indicators(line);
                indicators.insert(name, readings[index].map(|reading| reading.amplitude));
                indicators.insert(ratio, readings[index].map(|reading| reading.to_background));
            }
            let Some((highest, reading)) = highest else { break };
            claimed.push(Comb { spacing: reading.position, tolerance: BEARING_TOLERANCE });
            let (bearing, line) = pending.remove(highest);
            detected.push(DetectedLine { bearing: &bearing.name, line, position: reading.position });
        }
        detected
    }

    /// Measures a line: root sum square of the amplitudes of its first harmonics, and root mean square of
    /// their ratios to the background.
    ///
    /// Searches the position at which the harmonics together stand highest above the background, within slip
    /// and speed uncertainty. Lines of shafts and of the `claimed` combs are excluded, except for a comb that
    /// may be this line itself; harmonics that these hide do not count. [`NotComputed::OtherLine`] if they
    /// hide the first harmonic of a line that stands out or, where none does, of one without slip.
    fn read(
        &self,
        bearing: &Bearing,
        line: BearingLine,
        claimed: &[Comb],
        scratch: &mut Vec<f64>,
    ) -> Result<Reading, NotComputed> {
        let (shaft_hz, uncertainty) = self.shaft.ok_or(NotComputed::NoSpeed)?;
        let slip = SLIP + uncertainty;
        let position = bearing.order(line) * shaft_hz / self.resolution_hz;
        let [low, high] = [position * (1.0 - slip), position * (1.0 + slip)];
        if low < RESOLVED_BINS {
            return Err(NotComputed::TooShort);
        }
        let orders = (1..=HARMONICS)
            .take_while(|order| fits(*order as f64 * high + 2.0, self.amplitude.len()))
            .count();
        if orders == 0 {
            return Err(NotComputed::AboveEnvelope);
        }
        let shafts = [1.0, bearing.shaft_turns].map(|turns| Comb {
            spacing: turns * shaft_hz / self.resolution_hz,
            tolerance: SHAFT_TOLERANCE + uncertainty,
        });
        let others = claimed.iter().filter(|comb| !(low - 1.0..=high + 1.0).contains(&comb.spacing));
        let combs: Vec<Comb> =
            shafts.iter().chain(others).filter(|comb| comb.spacing >= MIN_SPACING_BINS).copied().collect();
        let is_others = |bin: usize| combs.iter().any(|comb| comb.contains(bin));
        let mut noise = [0.0; HARMONICS];
        for (order, noise) in (1..).zip(&mut noise[..orders]) {
            let window = [f64::from(order) * low, f64::from(order) * high];
            *noise = self.background(window, position, &is_others, scratch).ok_or(NotComputed::TooShort)?;
        }
        let noise = &noise[..orders];
        let own_bin = |order: i32, position: f64| {
            Some((f64::from(order) * position).round() as usize).filter(|bin| !is_others(*bin))
        };
        let score = |position: f64| -> f64 {
            let ratio = |(order, noise): (i32, &f64)| {
                own_bin(order, position).map_or(0.0, |bin| (self.amplitude[bin] / noise).powi(2))
            };
            (1..).zip(noise).map(ratio).sum()
        };
        let step = 0.5 / orders as f64;
        let candidates = ((high - low) / step) as usize + 1;
        let (mut best, mut highest, mut hidden) = (position, f64::NEG_INFINITY, 0.0_f64);
        for candidate in 0..candidates {
            let at = low + candidate as f64 * step;
            let score = score(at);
            if own_bin(1, at).is_none() {
                hidden = hidden.max(score);
            } else if score > highest {
                (best, highest) = (at, score);
            }
        }
        if hidden > highest.max(orders as f64 * MIN_CLAIM_RATIO * MIN_CLAIM_RATIO) {
            return Err(NotComputed::OtherLine);
        }
        let read = |(order, noise): (i32, &f64)| {
            let bin = own_bin(order, best)?;
            let position = f64::from(order) * best;
            let line = read_line(self.amplitude, position)
                .filter(|line| !is_others(line.position.round() as usize))
                .unwrap_or(LineReading { position, amplitude: self.amplitude[bin] });
            Some((order, line, line.amplitude / noise))
        };
        let harmonics: SmallVec<[_; HARMONICS]> = (1..).zip(noise).filter_map(read).collect();
        let Some((1, first, first_to_background)) = harmonics.first().copied() else {
            return Err(NotComputed::OtherLine);
        };
        let power: f64 = harmonics.iter().map(|(_, line, _)| line.amplitude * line.amplitude).sum();
        let ratios: f64 = harmonics.iter().map(|(.., ratio)| ratio * ratio).sum();
        let reading = Reading {
            amplitude: power.sqrt(),
            to_background: (ratios / harmonics.len() as f64).sqrt(),
            first_to_background,
            position: first.position,
        };
        if own_bin(1, position).is_none() && !reading.stands_out() {
            return Err(NotComputed::OtherLine);
        }
        Ok(reading)
    }

    /// Returns the root-mean-square amplitude of the noise in one bin on both sides of a window.
    fn background(
        &self,
        [low, high]: [f64; 2],
        spacing: f64,
        is_others: &dyn Fn(usize) -> bool,
        scratch: &mut Vec<f64>,
    ) -> Option<f64> {
        let [min, max] = BACKGROUND_BINS;
        let reach = (0.5 * spacing).clamp(min, max);
        let excluded = [low - LINE_REACH_BINS, high + LINE_REACH_BINS];
        let first = (excluded[0] - reach).max(MAIN_LOBE_BINS).ceil() as usize;
        let last = ((excluded[1] + reach) as usize).min(self.amplitude.len() - 1);
        let is_beside =
            |bin: &usize| !(excluded[0]..=excluded[1]).contains(&(*bin as f64)) && !is_others(*bin);
        scratch.clear();
        scratch.extend((first..=last).filter(is_beside).map(|bin| self.amplitude[bin]));
        if scratch.len() < MIN_BACKGROUND_BINS {
            return None;
        }
        noise_amplitude(scratch).filter(|noise| *noise > 0.0)
    }

    /// Returns the line with the highest ratio to the background up to a frequency in hertz, attributed to
    /// one of the `detected` bearing lines if possible.
    pub(super) fn strongest(
        &self,
        detected: &[DetectedLine<'_>],
        band_hz: [f64; 2],
        highest_hz: f64,
        scratch: &mut Vec<f64>,
    ) -> Option<EnvelopeLine> {
        let end = ((highest_hz / self.resolution_hz) as usize).min(self.amplitude.len().saturating_sub(2));
        let first = RESOLVED_BINS as usize;
        let mut best: Option<(usize, f64)> = None;
        for begin in (first..end).step_by(BLOCK_BINS) {
            let block = begin..(begin + BLOCK_BINS).min(end);
            // The last block is extended backwards, so that its background has as many bins.
            let around = block.end.saturating_sub(BLOCK_BINS).max(first)..block.end;
            scratch.clear();
            scratch.extend_from_slice(&self.amplitude[around]);
            let Some(noise) = noise_amplitude(scratch).filter(|noise| *noise > 0.0) else { continue };
            let peaks = block.filter(|&bin| {
                let [before, here, after] = [bin - 1, bin, bin + 1].map(|bin| self.amplitude[bin]);
                here > before && here >= after
            });
            for bin in peaks {
                let ratio = self.amplitude[bin] / noise;
                if best.is_none_or(|(_, highest)| ratio > highest) {
                    best = Some((bin, ratio));
                }
            }
        }
        let (bin, to_background) = best.filter(|(_, ratio)| *ratio >= DETECTION_RATIO)?;
        let position = read_line(self.amplitude, bin as f64)?.position;
        Some(EnvelopeLine {
            frequency_hz: position * self.resolution_hz,
            to_background,
            band_hz,
            source: self.source(position, detected),
        })
    }

    /// Returns the known source at a position, shafts before bearings.
    fn source(&self, position: f64, detected: &[DetectedLine<'_>]) -> Option<LineSource> {
        let (shaft_hz, uncertainty) = self.shaft?;
        let harmonic_of = |spacing: f64, tolerance: f64| {
            let harmonic = (position / spacing).round();
            let off = (position - harmonic * spacing).abs();
            let is_near = off <= 1.0 + tolerance * position && off < 0.25 * spacing;
            ((1.0..=f64::from(MAX_SOURCE_HARMONIC)).contains(&harmonic) && is_near).then_some(harmonic as u32)
        };
        let shaft = harmonic_of(shaft_hz / self.resolution_hz, SHAFT_TOLERANCE + uncertainty);
        if let Some(harmonic) = shaft {
            return Some(LineSource::Shaft { harmonic });
        }
        detected.iter().find_map(|detected| {
            let harmonic = harmonic_of(detected.position, BEARING_TOLERANCE)?;
            Some(LineSource::Bearing { bearing: detected.bearing.to_owned(), line: detected.line, harmonic })
        })
    }
}
