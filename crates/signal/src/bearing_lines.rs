//! The lines of rolling bearings in an envelope spectrum, and its strongest line. Positions are in bins.

use serde::{Deserialize, Serialize};

use super::bearing::{Bearing, BearingLine};
use super::indicators::{Indicators, NotComputed};
use super::line::{MAIN_LOBE_BINS, STANDING_OUT, fits, noise_amplitude, read_line};

/// Harmonics of a fault frequency that are summed up.
const HARMONICS: usize = 3;

/// Rolling elements slip: a line lies within this part of where the geometry puts it.
const SLIP: f64 = 0.02;

/// A line has to lie so many bins from zero.
const RESOLVED_BINS: f64 = 4.0;

/// Harmonics are told from other lines where they stand so many bins apart.
const APART_BINS: f64 = 8.0;

/// What belongs to a line: its main lobe, and a part of its position, as speeds wander and elements slip.
const CLEAR_BINS: f64 = MAIN_LOBE_BINS + 0.5;
const SHAFT_WANDER: f64 = 5e-4;
const BEARING_WANDER: f64 = 3e-3;

/// A line of a bearing from this ratio to its background on is none of another line's.
const TAKEN: f64 = 3.0;

/// Bins on each side of a line's window that the background is taken from, at least and at most.
const BACKGROUND_BINS: [f64; 2] = [8.0, 32.0];

/// Fewest bins of a background.
const MIN_BACKGROUND_BINS: usize = 8;

/// Bins of one background where the strongest line is looked for.
const BLOCK_BINS: usize = 64;

/// The strongest line is one of the first so many harmonics of a bearing's frequency or of the shaft's rate.
const NAMED_HARMONICS: u32 = 5;

/// The strongest line of a record's envelope spectrum, where it stands out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct EnvelopeLine {
    /// Its frequency in hertz.
    pub frequency_hz: f64,
    /// Its amplitude over that of the noise around it.
    pub to_background: f64,
    /// The band whose envelope it is in, in hertz.
    pub band_hz: [f64; 2],
    /// What is known to turn or strike at that rate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<LineSource>,
}

/// What a line of an envelope spectrum comes from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum LineSource {
    /// A described bearing.
    Bearing {
        /// Its name.
        bearing: String,
        /// Which of its frequencies.
        line: BearingLine,
        /// Which harmonic of that.
        harmonic: u32,
    },
    /// The shaft whose speed is meant.
    Shaft {
        /// Which harmonic of its rate.
        harmonic: u32,
    },
}

impl EnvelopeLine {
    /// In words.
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

/// An envelope spectrum, and what is known of the shaft.
pub(super) struct EnvelopeLines<'a> {
    /// Hann amplitudes.
    pub(super) amplitude: &'a [f64],
    /// Distance of bins in hertz.
    pub(super) resolution_hz: f64,
    /// The shaft's rotational frequency in hertz, and the part by which it may be off.
    pub(super) shaft: Option<(f64, f64)>,
}

/// A line and its harmonics.
#[derive(Debug, Clone, Copy)]
struct Comb {
    spacing: f64,
    wander: f64,
}

/// A bearing's line that stands out.
#[derive(Debug, Clone, Copy)]
pub(super) struct StandingLine<'a> {
    bearing: &'a str,
    line: BearingLine,
    /// Where its first harmonic is.
    position: f64,
}

/// A bearing's line as it was read.
#[derive(Debug, Clone, Copy)]
struct Reading {
    /// Root sum square of its harmonics' amplitudes.
    amplitude: f64,
    /// Root mean square of their ratios to the background.
    to_background: f64,
    /// Where the first harmonic is.
    position: f64,
}

impl Comb {
    /// Whether a bin belongs to one of its harmonics.
    fn holds(self, bin: usize) -> bool {
        let bin = bin as f64;
        let harmonic = (bin / self.spacing).round();
        harmonic > 0.0 && (bin - harmonic * self.spacing).abs() <= CLEAR_BINS + self.wander * bin
    }
}

impl EnvelopeLines<'_> {
    /// Puts down each bearing's lines, the one that stands furthest out first: what belongs to it and its
    /// harmonics is none of the others'. Those that stand out are returned.
    pub(super) fn indicate<'b>(
        &self,
        bearings: &'b [Bearing],
        scratch: &mut Vec<f64>,
        indicators: &mut Indicators,
    ) -> Vec<StandingLine<'b>> {
        let mut open: Vec<(&Bearing, BearingLine)> =
            bearings.iter().flat_map(|bearing| BearingLine::ALL.map(|line| (bearing, line))).collect();
        let (mut taken, mut standing) = (Vec::new(), Vec::new());
        while !open.is_empty() {
            let read: Vec<Result<Reading, NotComputed>> =
                open.iter().map(|(bearing, line)| self.read(bearing, *line, &taken, scratch)).collect();
            let ratio = |index: &usize| read[*index].map_or(0.0, |reading| reading.to_background);
            let highest = (0..open.len()).max_by(|a, b| ratio(a).total_cmp(&ratio(b))).unwrap_or(0);
            let stands_out = read[highest].ok().filter(|reading| reading.to_background >= TAKEN);
            let told: Vec<usize> = match stands_out {
                Some(_) => vec![highest],
                None => (0..open.len()).collect(),
            };
            for index in told {
                let (bearing, line) = open[index];
                let [name, ratio] = bearing.indicators(line);
                indicators.insert(name, read[index].map(|reading| reading.amplitude));
                indicators.insert(ratio, read[index].map(|reading| reading.to_background));
            }
            let Some(reading) = stands_out else { break };
            taken.push(Comb { spacing: reading.position, wander: BEARING_WANDER });
            let (bearing, line) = open.remove(highest);
            standing.push(StandingLine { bearing: &bearing.name, line, position: reading.position });
        }
        standing
    }

    /// Root sum square of the amplitudes of a line's first harmonics, and root mean square of their ratios
    /// to the background.
    ///
    /// The line is looked for where its harmonics together stand highest above the background, within slip
    /// and what the speed may be off by. Lines of shafts are none of the bearing's, nor those of combs that
    /// are `taken`, but for one that may be this line's own.
    fn read(
        &self,
        bearing: &Bearing,
        line: BearingLine,
        taken: &[Comb],
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
            wander: SHAFT_WANDER + uncertainty,
        });
        let others = taken.iter().filter(|comb| !(low - 1.0..=high + 1.0).contains(&comb.spacing));
        let combs: Vec<Comb> =
            shafts.iter().chain(others).filter(|comb| comb.spacing >= APART_BINS).copied().collect();
        let is_others = |bin: usize| combs.iter().any(|comb| comb.holds(bin));
        let mut noise = [0.0; HARMONICS];
        for (order, noise) in (1..).zip(&mut noise[..orders]) {
            let window = [f64::from(order) * low, f64::from(order) * high];
            *noise = self.background(window, position, &is_others, scratch).ok_or(NotComputed::TooShort)?;
        }
        let noise = &noise[..orders];
        let score = |position: f64| -> f64 {
            let ratio = |(order, noise): (i32, &f64)| {
                let bin = (f64::from(order) * position).round() as usize;
                if is_others(bin) { 0.0 } else { (self.amplitude[bin] / noise).powi(2) }
            };
            (1..).zip(noise).map(ratio).sum()
        };
        let step = 0.5 / orders as f64;
        let candidates = ((high - low) / step) as usize + 1;
        let (mut best, mut highest) = (position, f64::NEG_INFINITY);
        for candidate in 0..candidates {
            let at = low + candidate as f64 * step;
            let score = score(at);
            if score > highest {
                (best, highest) = (at, score);
            }
        }
        let (mut power, mut ratios, mut first) = (0.0, 0.0, best);
        for (order, noise) in (1..).zip(noise) {
            let Some(line) = read_line(self.amplitude, f64::from(order) * best) else { continue };
            if !is_others(line.position.round() as usize) {
                power += line.amplitude * line.amplitude;
                ratios += (line.amplitude / noise).powi(2);
                if order == 1 {
                    first = line.position;
                }
            }
        }
        let to_background = (ratios / orders as f64).sqrt();
        Ok(Reading { amplitude: power.sqrt(), to_background, position: first })
    }

    /// Root-mean-square amplitude of the noise in one bin to both sides of a window.
    fn background(
        &self,
        [low, high]: [f64; 2],
        spacing: f64,
        is_others: &dyn Fn(usize) -> bool,
        scratch: &mut Vec<f64>,
    ) -> Option<f64> {
        let [least, most] = BACKGROUND_BINS;
        let reach = (0.5 * spacing).clamp(least, most);
        let clear = [low - CLEAR_BINS, high + CLEAR_BINS];
        let first = (clear[0] - reach).max(MAIN_LOBE_BINS).ceil() as usize;
        let last = ((clear[1] + reach) as usize).min(self.amplitude.len() - 1);
        let is_beside = |bin: &usize| !(clear[0]..=clear[1]).contains(&(*bin as f64)) && !is_others(*bin);
        scratch.clear();
        scratch.extend((first..=last).filter(is_beside).map(|bin| self.amplitude[bin]));
        if scratch.len() < MIN_BACKGROUND_BINS {
            return None;
        }
        noise_amplitude(scratch).filter(|noise| *noise > 0.0)
    }

    /// The line that stands furthest out, up to a frequency in hertz, named by the bearings' lines that are
    /// `standing` out.
    pub(super) fn strongest(
        &self,
        standing: &[StandingLine<'_>],
        band_hz: [f64; 2],
        highest_hz: f64,
        scratch: &mut Vec<f64>,
    ) -> Option<EnvelopeLine> {
        let end = ((highest_hz / self.resolution_hz) as usize).min(self.amplitude.len().saturating_sub(2));
        let first = RESOLVED_BINS as usize;
        let mut best: Option<(usize, f64)> = None;
        for begin in (first..end).step_by(BLOCK_BINS) {
            let block = begin..(begin + BLOCK_BINS).min(end);
            // The last block borrows from the one before, so that its background is of as many bins.
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
        let (bin, to_background) = best.filter(|(_, ratio)| *ratio >= STANDING_OUT)?;
        let position = read_line(self.amplitude, bin as f64)?.position;
        Some(EnvelopeLine {
            frequency_hz: position * self.resolution_hz,
            to_background,
            band_hz,
            source: self.source(position, standing),
        })
    }

    /// What is known to have a line there: the shaft before a bearing.
    fn source(&self, position: f64, standing: &[StandingLine<'_>]) -> Option<LineSource> {
        let (shaft_hz, uncertainty) = self.shaft?;
        let harmonic_of = |spacing: f64, wander: f64| {
            let harmonic = (position / spacing).round();
            let off = (position - harmonic * spacing).abs();
            let is_near = off <= 1.0 + wander * position && off < 0.25 * spacing;
            ((1.0..=f64::from(NAMED_HARMONICS)).contains(&harmonic) && is_near).then_some(harmonic as u32)
        };
        let shaft = harmonic_of(shaft_hz / self.resolution_hz, SHAFT_WANDER + uncertainty);
        if let Some(harmonic) = shaft {
            return Some(LineSource::Shaft { harmonic });
        }
        standing.iter().find_map(|of| {
            let harmonic = harmonic_of(of.position, BEARING_WANDER)?;
            Some(LineSource::Bearing { bearing: of.bearing.to_owned(), line: of.line, harmonic })
        })
    }
}
