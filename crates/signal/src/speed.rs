//! The shaft speed of a record, given with it or found from its mesh comb.

use serde::{Deserialize, Serialize};

use super::comb::{MESH_RESOLVED_BINS, MeshComb};
use super::comb_support::{CombDoubt, Reading, Support, min_harmonics, smeared_support, support};
use super::line::{DETECTION_RATIO, MAIN_LOBE_BINS, background, fits, read_line};
use super::mesh_comb;
use super::mesh_context::MeshContext;
use super::not_computed::NotComputed;
use super::record::RecordOf;
use super::smeared_comb;

/// Source of a shaft speed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum SpeedSource {
    /// Given with the record.
    Record,
    /// The mean over the pulses of the record's tachometer.
    Tachometer,
    /// The asset's nominal speed, configured as exact.
    Asset,
    /// Found from the comb of mesh harmonics within the tolerance around nominal.
    MeshComb,
    /// For a machine without a mesh: found from the harmonics of the shaft rate within the tolerance.
    ShaftLines,
    /// For a machine without a mesh: the nominal speed, within its tolerance.
    Nominal,
}

/// A record's shaft speed and its source.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ShaftSpeed {
    /// Rotational frequency of the driving shaft in hertz.
    pub shaft_speed_hz: f64,
    /// Source of the speed.
    pub source: SpeedSource,
    /// Mesh frequency in hertz: teeth × shaft speed; 0 and omitted without a mesh.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub mesh_frequency_hz: f64,
    /// Ratio of the comb's amplitude to the background (root mean square over its lines); `None` if the speed
    /// is given and no comb was detected.
    pub comb_to_background: Option<f64>,
    /// Number of mesh harmonics that stand out from the background.
    #[serde(default)]
    pub harmonics_found: u32,
    /// Number of harmonics searched: up to 16, as far as the record reaches.
    #[serde(default)]
    pub harmonics_sought: u32,
    /// Why the speed or the number of teeth may be wrong.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub doubt: Option<SpeedDoubt>,
}

/// Why a record's shaft speed or the asset's number of teeth may be wrong.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(tag = "reason", rename_all = "snake_case")]
pub enum SpeedDoubt {
    /// Fewer than two harmonics of the mesh stand out, or not the only one below half the sampling rate.
    FewHarmonics,
    /// The lines fit another mesh frequency better.
    OtherMesh {
        /// That mesh frequency in hertz.
        mesh_frequency_hz: f64,
        /// The number of teeth whose shaft spaces the sidebands of that mesh; omitted if they do not show.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        teeth: Option<u32>,
    },
    /// The sidebands of the mesh are spaced by another shaft rate.
    OtherShaft {
        /// That shaft's rotational frequency in hertz.
        shaft_speed_hz: f64,
    },
}

impl ShaftSpeed {
    /// Creates the speed of a shaft without teeth.
    fn without_mesh(shaft_speed_hz: f64, source: SpeedSource) -> Self {
        Self {
            shaft_speed_hz,
            source,
            mesh_frequency_hz: 0.0,
            comb_to_background: None,
            harmonics_found: 0,
            harmonics_sought: 0,
            doubt: None,
        }
    }

    /// Returns the doubt as a sentence that asks whether teeth and speed are right, if there is one.
    pub fn doubt_message(&self) -> Option<String> {
        let doubt = self.doubt?;
        let (shaft_hz, mesh_hz) = (self.shaft_speed_hz, self.mesh_frequency_hz);
        let teeth = mesh_hz / shaft_hz;
        let described = format!("{teeth:.0} × {shaft_hz:.2} Hz");
        let evidence = match doubt {
            SpeedDoubt::FewHarmonics => format!(
                "{} of {} harmonics of the mesh frequency {mesh_hz:.1} Hz ({described}) stand out, expected at least {}",
                self.harmonics_found,
                self.harmonics_sought,
                min_harmonics(self.harmonics_sought)
            ),
            SpeedDoubt::OtherMesh { mesh_frequency_hz, teeth: Some(count) } => format!(
                "the lines fit {count} × {:.2} Hz better than {described} (a mesh frequency of {mesh_frequency_hz:.1} Hz instead of {mesh_hz:.1} Hz)",
                mesh_frequency_hz / f64::from(count)
            ),
            SpeedDoubt::OtherMesh { mesh_frequency_hz, teeth: None } => format!(
                "the lines fit a mesh frequency of {mesh_frequency_hz:.1} Hz ({teeth:.0} × {:.2} Hz or {} × {shaft_hz:.2} Hz) better than {mesh_hz:.1} Hz ({described})",
                mesh_frequency_hz / teeth,
                whole_teeth(mesh_frequency_hz, shaft_hz).0
            ),
            SpeedDoubt::OtherShaft { shaft_speed_hz } => {
                let (count, other_hz) = whole_teeth(mesh_hz, shaft_speed_hz);
                format!("the shaft lines fit {count} × {other_hz:.2} Hz better than {described}")
            }
        };
        Some(format!("the shaft speed is in doubt: {evidence}; are the tooth counts and the speed correct?"))
    }
}

/// Returns the number of teeth with which a shaft has a mesh frequency, in words, and its rate with that
/// number: a whole one if the measured rates are close to one.
fn whole_teeth(mesh_hz: f64, shaft_hz: f64) -> (String, f64) {
    const MAX_DEVIATION: f64 = 0.2;
    let teeth = mesh_hz / shaft_hz;
    let whole = teeth.round();
    if whole >= 1.0 && (teeth - whole).abs() <= MAX_DEVIATION {
        (format!("{whole:.0}"), mesh_hz / whole)
    } else {
        (format!("{teeth:.1}"), shaft_hz)
    }
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl SpeedDoubt {
    fn of(doubt: CombDoubt, reading: Option<Reading>, resolution_hz: f64) -> Self {
        match doubt {
            CombDoubt::FewHarmonics => Self::FewHarmonics,
            CombDoubt::OtherMesh(bins) => Self::OtherMesh {
                mesh_frequency_hz: reading.map_or(bins, |reading| reading.mesh) * resolution_hz,
                teeth: reading.and_then(|reading| reading.teeth),
            },
            CombDoubt::OtherShaft(bins) => Self::OtherShaft { shaft_speed_hz: bins * resolution_hz },
        }
    }
}

/// A speed given with a record or an asset may deviate by this fraction; the lines are searched within it.
const GIVEN_SPEED_TOLERANCE: f64 = 1e-3;

/// The lines of a better-fitting comb are searched within this fraction of its frequency.
const OTHER_MESH_TOLERANCE: f64 = 0.005;

/// Number of harmonics searched of a shaft without teeth, and how many must stand out.
const SHAFT_HARMONICS: u32 = 5;
const MIN_SHAFT_HARMONICS: u32 = 2;

/// The mesh located in one record's spectrum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LocatedMesh {
    /// The shaft speed, if known.
    pub(super) speed: Option<ShaftSpeed>,
    /// The mesh frequency in bins according to the lines, or why there are no lines to read.
    pub(super) mesh: Result<f64, NotComputed>,
    /// Whether only smeared lines support it.
    pub(super) is_smeared: bool,
}

impl LocatedMesh {
    /// Sets how many harmonics stand out once the fluctuation of the speed is removed. Noise near a resonance
    /// looks like a smeared line, but does not become a narrow one.
    pub(super) fn verify(&mut self, found: u32) {
        if let Some(speed) = &mut self.speed {
            speed.harmonics_found = found;
            if found < min_harmonics(speed.harmonics_sought) {
                speed.doubt = speed.doubt.or(Some(SpeedDoubt::FewHarmonics));
            }
        }
    }
}

/// Returns the speed given with a record: that of its operating point, else the mean of its tachometer.
pub(super) fn given_speed(record: &RecordOf<'_>) -> Option<(f64, SpeedSource)> {
    let own = record.operating_point().shaft_speed_hz.map(|speed| (speed, SpeedSource::Record));
    own.or_else(|| {
        let angle = record.tachometer_angle()?.ok()?;
        Some((angle.mean_speed_hz(), SpeedSource::Tachometer))
    })
}

/// Finds the comb in a range of mesh frequencies and its support. If its narrow lines leave a doubt, another
/// comb in the range is returned that has none, of narrow or of smeared lines.
fn find_comb(
    amplitude: &[f64],
    [low, high]: [f64; 2],
    context: &MeshContext,
    scratch: &mut Vec<f64>,
    log_ratios: &mut Vec<f64>,
) -> Option<(MeshComb, Support)> {
    let mut find = |range| {
        let comb = mesh_comb::find(amplitude, range, context.teeth, scratch)?;
        Some((comb, support(amplitude, comb.mesh, context, scratch, log_ratios)))
    };
    let first = find([low, high]);
    let doubt = first.and_then(|(_, lines)| lines.doubt);
    let other_in_range = doubt.and_then(CombDoubt::other_mesh).filter(|other| (low..=high).contains(other));
    if let Some(other) = other_in_range {
        let near = [other * (1.0 - OTHER_MESH_TOLERANCE), other * (1.0 + OTHER_MESH_TOLERANCE)];
        if let Some(better) = find(near).filter(|(_, lines)| lines.doubt.is_none()) {
            return Some(better);
        }
    }
    // A complete comb of narrow lines, of this mesh or of one outside the range, means that the speed is
    // steady: there is no smeared line.
    if first.is_some_and(|(_, lines)| {
        matches!(lines.doubt, None | Some(CombDoubt::OtherShaft(_)))
            || lines.is_complete()
            || lines.other_is_complete && other_in_range.is_none()
    }) {
        return first;
    }
    let smeared = smeared_comb::find(amplitude, [low, high], scratch)
        .map(|comb| (comb, smeared_support(amplitude, comb.mesh, context, scratch, log_ratios)));
    match (first, smeared) {
        (first, Some((_, lines))) if lines.doubt.is_some() => first.or(smeared),
        (first, smeared) => smeared.or(first),
    }
}

/// Finds the speed of a shaft without teeth from the harmonics of its rate, of which at least two must stand
/// out.
fn find_shaft(
    amplitude: &[f64],
    resolution_hz: f64,
    context: &MeshContext,
    scratch: &mut Vec<f64>,
) -> Option<ShaftSpeed> {
    let range = [-1.0, 1.0]
        .map(|side| context.nominal_shaft_speed_hz * (1.0 + side * context.tolerance) / resolution_hz);
    if !fits(range[1], amplitude.len()) {
        return None;
    }
    let comb = mesh_comb::find(amplitude, range, 1, scratch)?;
    let sought = (1..=SHAFT_HARMONICS)
        .take_while(|order| fits(f64::from(*order) * comb.mesh, amplitude.len()))
        .collect::<Vec<_>>();
    let mut stands_out = |order: &&u32| {
        let position = f64::from(**order) * comb.mesh;
        let noise = background(amplitude, position, Some(comb.mesh), 2.0 * comb.mesh, scratch);
        let line = read_line(amplitude, position);
        line.zip(noise).is_some_and(|(line, noise)| line.amplitude >= DETECTION_RATIO * noise)
    };
    let found = sought.iter().filter(&mut stands_out).count() as u32;
    (found >= MIN_SHAFT_HARMONICS).then(|| ShaftSpeed {
        comb_to_background: Some(comb.to_background),
        harmonics_found: found,
        harmonics_sought: sought.len() as u32,
        ..ShaftSpeed::without_mesh(comb.mesh * resolution_hz, SpeedSource::ShaftLines)
    })
}

/// Locates the mesh: by the speed given with the record, else the asset's exact one, else the comb within the
/// tolerance around nominal.
///
/// A given speed is not changed; only its lines are located by the comb within ± 0.1 %, as the few digits of
/// a tachometer's mean are often not exact to a bin. `constant` means that all samples are equal.
pub(super) fn locate(
    amplitude: &[f64],
    resolution_hz: f64,
    given: Option<(f64, SpeedSource)>,
    context: &MeshContext,
    constant: bool,
    scratch: &mut Vec<f64>,
    log_ratios: &mut Vec<f64>,
) -> LocatedMesh {
    let teeth = f64::from(context.teeth);
    let nominal_hz = context.nominal_shaft_speed_hz;
    let exact = context.nominal_is_exact && nominal_hz > 0.0;
    let given = given.or(exact.then_some((nominal_hz, SpeedSource::Asset)));
    if context.teeth == 0 {
        let shaft = match given {
            Some((speed_hz, source)) => Some(ShaftSpeed::without_mesh(speed_hz, source)),
            None if nominal_hz > 0.0 && nominal_hz.is_finite() => {
                let found = find_shaft(amplitude, resolution_hz, context, scratch).filter(|_| !constant);
                Some(found.unwrap_or(ShaftSpeed::without_mesh(nominal_hz, SpeedSource::Nominal)))
            }
            None => None,
        };
        let reason = if constant { NotComputed::Constant } else { NotComputed::NoSpeed };
        return LocatedMesh { speed: shaft, mesh: Err(reason), is_smeared: false };
    }
    let (centre_hz, tolerance) = match given {
        Some((speed, _)) => (speed, GIVEN_SPEED_TOLERANCE),
        None => (nominal_hz, context.tolerance.max(0.0)),
    };
    let centre = teeth * centre_hz / resolution_hz;
    let reason = if constant {
        Some(NotComputed::Constant)
    } else if !(centre > 0.0 && centre.is_finite()) {
        Some(NotComputed::NoSpeed)
    } else if amplitude.len() < 2 || centre * (1.0 + tolerance) < MESH_RESOLVED_BINS {
        Some(NotComputed::TooShort)
    } else if !fits(centre * (1.0 - tolerance).max(0.0), amplitude.len()) {
        Some(NotComputed::AboveNyquist)
    } else {
        None
    };
    let comb = match reason {
        Some(_) => None,
        None => {
            let highest = amplitude.len() as f64 - 1.0 - MAIN_LOBE_BINS;
            let range = [centre * (1.0 - tolerance), (centre * (1.0 + tolerance)).min(highest)];
            find_comb(amplitude, range, context, scratch, log_ratios)
        }
    };
    let (comb, lines) = comb.unzip();
    let lines = lines.or_else(|| {
        (given.is_some() && reason.is_none())
            .then(|| support(amplitude, centre, context, scratch, log_ratios))
    });
    let comb_to_background = comb.map(|comb| comb.to_background);
    let (harmonics_found, harmonics_sought) =
        lines.map_or((0, 0), |Support { found, sought, .. }| (found, sought));
    let doubt = lines.and_then(|lines| Some(SpeedDoubt::of(lines.doubt?, lines.reading, resolution_hz)));
    let is_smeared = lines.is_some_and(|lines| lines.is_smeared);
    match given {
        Some((shaft_speed_hz, source)) => LocatedMesh {
            speed: Some(ShaftSpeed {
                shaft_speed_hz,
                source,
                mesh_frequency_hz: teeth * shaft_speed_hz,
                comb_to_background,
                harmonics_found,
                harmonics_sought,
                doubt,
            }),
            mesh: reason.map_or(Ok(comb.map_or(centre, |comb| comb.mesh)), Err),
            is_smeared,
        },
        None => LocatedMesh {
            speed: comb.map(|comb| ShaftSpeed {
                shaft_speed_hz: comb.mesh * resolution_hz / teeth,
                source: SpeedSource::MeshComb,
                mesh_frequency_hz: comb.mesh * resolution_hz,
                comb_to_background,
                harmonics_found,
                harmonics_sought,
                doubt,
            }),
            mesh: reason.map_or(comb.map(|comb| comb.mesh).ok_or(NotComputed::NoSpeed), Err),
            is_smeared,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_doubt_names_whole_tooth_counts() {
        let speed = |doubt| ShaftSpeed {
            mesh_frequency_hz: 480.0,
            doubt: Some(doubt),
            ..ShaftSpeed::without_mesh(20.0, SpeedSource::Nominal)
        };
        for (shaft_speed_hz, expected) in
            [(480.0 / 24.9, "25 × 19.20 Hz"), (15.0, "32 × 15.00 Hz"), (480.0 / 18.5, "18.5 × 25.95 Hz")]
        {
            let message = speed(SpeedDoubt::OtherShaft { shaft_speed_hz }).doubt_message().unwrap();
            assert!(message.contains(&format!("fit {expected} better than 24 × 20.00 Hz")), "{message}");
        }
        let other = SpeedDoubt::OtherMesh { mesh_frequency_hz: 640.0, teeth: None };
        let message = speed(other).doubt_message().unwrap();
        assert!(message.contains("(24 × 26.67 Hz or 32 × 20.00 Hz)"), "{message}");
    }
}
