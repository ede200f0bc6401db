//! Novelty: whether wear explains a record, and if not, whether the sensor or the machine is the cause.

mod faults;

use std::f64::consts::SQRT_2;

use serde::{Deserialize, Serialize};

pub(super) use self::faults::TEETH;
pub use self::faults::{SensorFault, SuspectedFault};
use super::cusum::Cusums;
use super::deviation::{Deviation, chi_square_score, normal_tail};
use flankwatch_signal::{EnvelopeLine, Features};

/// Below this p-value, wear does not explain a record.
pub(super) const MIN_P_VALUE: f64 = 1e-4;

/// Factors by which correlation widens the sum of squared deviations of lines and of checks.
const INFLATION_LINES: f64 = 2.0;
const INFLATION_CHECKS: f64 = 1.6;

/// Weight of a check's deviation where it has fallen: a fault of the machine adds energy between the mesh
/// lines, while wear, load and speed may remove some. Sensor faults are judged at full weight.
const FALLEN_WEIGHT: f64 = 0.5;

/// The same where no mesh lines are compared: nothing else then distinguishes a fault from a machine that
/// runs down.
const FALLEN_WEIGHT_WITHOUT_LINES: f64 = 0.25;

/// Kinds of checks that have a CUSUM each: faults of one tooth and of the shaft raise them, wear does not.
const CUSUM_CHECKS: [&str; 2] = [TEETH, "ln_shaft_"];

/// Factor on their scatter in the baseline: they are not normally distributed.
const CUSUM_SCATTER: f64 = 1.25;

/// CUSUMs of the overall fit: of the lines to the best state, and of the checks.
const OVERALL_FIT: [&str; 2] = ["lines", "checks"];

/// Additional allowance of the overall fit in standard deviations, since an error of the library recurs in
/// every record. With twice the described mesh damping, 1.5 % of the records are flagged without these two
/// CUSUMs, 2.8 % with an allowance of 0.8, and 8 % with 0.5. A broken tooth that moves the lines alone is
/// detected after 3 to 6 records with 0.8, and hardly at all with 1.
const FIT_ALLOWANCE: f64 = 0.8;

/// The same without a library, whose errors would need the larger allowance.
const FIT_ALLOWANCE_WITHOUT_LINES: f64 = 0.5;

/// Natural logarithm of a dead sensor's noise floors over the baseline's (a factor of 50).
const DEAD_DROP: f64 = -3.9;

/// Natural logarithm of the least loss through a loose mount in the highest band (a factor of 4, as beyond
/// twice the resonance of a mass on a spring) ...
const LOOSE_LOSS: f64 = -1.4;

/// ... and of how much more is lost there than in the lowest band.
const LOOSE_SLOPE: f64 = -0.7;

/// Fewest noise floors that a sensor fault can be recognised from.
const MIN_FLOORS: usize = 4;

/// A tooth check beyond this many standard deviations indicates a tooth fault, whatever else has grown.
const MIN_TOOTH_SCORE: f64 = 4.0;

/// Where the record does not deviate by itself, a check that has grown by fewer standard deviations is no
/// sign of a fault.
const MIN_GROWN_SCORE: f64 = 3.0;

/// Deviation of one feature from its value in the best state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct FeatureDeviation {
    /// The feature's name.
    pub feature: String,
    /// Measured over expected amplitude, as a natural logarithm.
    pub ln_ratio: f64,
    /// The same in standard deviations.
    pub deviations: f64,
}

/// Novelty of a record: how well the best state explains it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Novelty {
    /// Probability that a record of the best state deviates at least as much; low where wear does not explain
    /// the record.
    pub p_value: f64,
    /// −log₁₀ of the p-value, at most 30: the quantity for alarms.
    pub score: f64,
    /// Whether the library does not explain the record.
    pub outside: bool,
    /// The sensor fault, where the sensor is the cause.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor_fault: Option<SensorFault>,
    /// The likeliest fault, where a check that wear hardly changes has grown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub suspected_fault: Option<SuspectedFault>,
    /// Other possible faults, likeliest first: their checks grew at least half as much.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub other_suspected_faults: Vec<SuspectedFault>,
    /// Edges in hertz of the octave whose energy has grown most, where energy has grown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub band_hz: Option<[f64; 2]>,
    /// The strongest line of the record's envelope spectrum, where impulses have grown and it stands out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub envelope_line: Option<EnvelopeLine>,
    /// The check that has deviated for several records, where that is stronger evidence than this record
    /// alone; `lines` or `checks` for the overall fit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lasting: Option<String>,
    /// The features that deviate most.
    pub largest_deviations: Vec<FeatureDeviation>,
}

impl Novelty {
    /// Returns −log₁₀ of a p-value, at most 30.
    pub(super) fn score_of(p_value: f64) -> f64 {
        (-p_value.max(1e-30).log10()).max(0.0)
    }
}

/// What is known of a record besides its deviations from the best state.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct RecordContext {
    /// Natural logarithm of the factor by which all values changed at once, where they did.
    pub(super) gain: Option<f64>,
    /// Whether the lines of the highest octave fell with its noise floor; `None` without lines there.
    pub(super) lines_fell: Option<bool>,
    /// Whether its kurtosis exceeds the healthy ones.
    pub(super) impulsive: bool,
}

/// Judges a record by its deviations from the best state, of lines and of checks, and by deviations that have
/// lasted over several records. `freedom` are the degrees of freedom of a deviation's scatter.
pub(super) fn judge(
    record: &Features,
    [lines, checks]: &[Vec<Deviation>; 2],
    freedom: f64,
    context: RecordContext,
    cusums: &mut Cusums,
) -> Novelty {
    let squares = |deviations: &[Deviation], fallen: f64| -> f64 {
        let weight = |d: &Deviation| if d.residual < 0.0 { fallen } else { 1.0 };
        deviations.iter().map(|d| (weight(d) * d.normal_score(freedom)).powi(2)).sum()
    };
    let z_lines = chi_square_score(squares(lines, 1.0) / INFLATION_LINES, lines.len());
    let of_checks = |fallen| chi_square_score(squares(checks, fallen) / INFLATION_CHECKS, checks.len());
    let (fallen, allowance) = if lines.is_empty() {
        (FALLEN_WEIGHT_WITHOUT_LINES, FIT_ALLOWANCE_WITHOUT_LINES)
    } else {
        (FALLEN_WEIGHT, FIT_ALLOWANCE)
    };
    let z_checks = of_checks(fallen);
    let (p_lines, p_checks) = (normal_tail(z_lines), normal_tail(z_checks));
    let twice = |p: f64| (2.0 * p).min(1.0);
    let p_record = twice(p_lines.min(p_checks));
    let p_with_falls = twice(p_lines.min(normal_tail(of_checks(1.0))));
    // A machine whose vibration had grown before it reached the end of the range is no sensor fault.
    let has_lasted = cusums.highest().is_some_and(|(_, p)| p < MIN_P_VALUE);
    let sensor_fault = match record.fault.and_then(SensorFault::of_samples) {
        Some(fault) if fault != SensorFault::Clipped || !has_lasted => Some(fault),
        _ if p_with_falls < MIN_P_VALUE => {
            sensor_fault(checks, context.lines_fell).or(context.gain.map(|_| SensorFault::GainChanged))
        }
        _ => None,
    };
    // A record with a sensor fault carries no information about the machine.
    if sensor_fault.is_none() {
        // Records of another length are averaged over other numbers of turns.
        for check in checks {
            if let Some(kind) = averaged_kind(&check.name) {
                cusums.continue_as(&check.name, |other| averaged_kind(other) == Some(kind));
            }
        }
        let followed = checks.iter().filter(|d| CUSUM_CHECKS.iter().any(|kind| d.name.starts_with(kind)));
        let followed =
            followed.map(|d| (d.name.as_str(), d.normal_score(freedom).copysign(d.residual) / CUSUM_SCATTER));
        let whole = OVERALL_FIT.into_iter().zip([z_lines, z_checks].map(|z| z - allowance));
        // A record without lines says nothing about how they fit: their sum stays as it is.
        let seen = whole.filter(|(_, z)| *z > f64::NEG_INFINITY);
        cusums.update(followed.chain(seen));
    }
    let lasting = cusums.highest().filter(|_| sensor_fault.is_none());
    let p_value = lasting.map_or(p_record, |(_, p)| p.min(p_record));
    let outside = p_value < MIN_P_VALUE;
    // A check that has grown in this record takes precedence over deviations that have lasted.
    let by_itself = if sensor_fault.is_none() && p_checks < MIN_P_VALUE { most_grown(checks) } else { None };
    let lasting = lasting.filter(|(_, p)| by_itself.is_none() && *p < MIN_P_VALUE);
    let fault_of = |check: &str| SuspectedFault::of(check, context.impulsive);
    // Where the overall fit has been poor, the check that has grown most in this record decides.
    let whole = |check: &str| {
        let grown = OVERALL_FIT.contains(&check).then(|| most_grown(checks)).flatten();
        grown.filter(|grown| grown.score() > MIN_GROWN_SCORE)
    };
    let check = by_itself.or_else(|| {
        let (check, _) = lasting?;
        whole(check).or_else(|| checks.iter().find(|d| d.name == check))
    });
    // A tooth fault also raises the energy between the mesh lines, in some records more than its own check.
    let tooth = cusums.highest_of(TEETH).filter(|(_, p)| *p < MIN_P_VALUE);
    let tooth = tooth.and_then(|(tooth, _)| checks.iter().find(|d| d.name == tooth));
    let check = check.map(|check| tooth.filter(|tooth| tooth.residual > 0.0).unwrap_or(check));
    let suspected_fault = check.and_then(|check| fault_of(&check.name));
    let mut largest: Vec<&Deviation> = lines.iter().chain(checks).collect();
    largest.sort_by(|a, b| b.score().abs().total_cmp(&a.score().abs()));
    Novelty {
        p_value,
        score: Novelty::score_of(p_value),
        outside: outside || sensor_fault.is_some(),
        sensor_fault,
        suspected_fault,
        other_suspected_faults: check
            .map_or_else(Vec::new, |check| other_suspected_faults(checks, check, fault_of)),
        band_hz: check.and_then(|check| octave_hz(&check.name)),
        envelope_line: record
            .envelope_line
            .clone()
            .filter(|_| suspected_fault == Some(SuspectedFault::ImpulsiveEnergy)),
        lasting: lasting.map(|(check, _)| check.to_owned()),
        largest_deviations: largest
            .into_iter()
            .take(3)
            .map(|d| FeatureDeviation {
                feature: d.name.to_string(),
                ln_ratio: d.residual,
                deviations: d.score(),
            })
            .collect(),
    }
}

/// Returns the check that has deviated most, if it has grown. A tooth check that stands out takes precedence,
/// as a tooth fault also raises the energy between the mesh lines.
fn most_grown(checks: &[Deviation]) -> Option<&Deviation> {
    let teeth = checks.iter().filter(|d| d.name.starts_with(TEETH) && d.score() > MIN_TOOTH_SCORE);
    if let Some(tooth) = teeth.max_by(|a, b| a.score().total_cmp(&b.score())) {
        return Some(tooth);
    }
    let most = checks.iter().max_by(|a, b| a.score().abs().total_cmp(&b.score().abs()))?;
    (most.residual > 0.0).then_some(most)
}

/// Returns the faults of other checks that have grown at least half as much as `largest`.
fn other_suspected_faults(
    checks: &[Deviation],
    largest: &Deviation,
    fault_of: impl Fn(&str) -> Option<SuspectedFault>,
) -> Vec<SuspectedFault> {
    let mut grown: Vec<&Deviation> =
        checks.iter().filter(|d| d.score() > MIN_GROWN_SCORE.max(0.5 * largest.score())).collect();
    grown.sort_by(|a, b| b.score().total_cmp(&a.score()));
    let mut faults: Vec<SuspectedFault> = fault_of(&largest.name).into_iter().collect();
    for fault in grown.into_iter().filter_map(|d| fault_of(&d.name)) {
        if !faults.contains(&fault) {
            faults.push(fault);
        }
    }
    faults.into_iter().skip(1).collect()
}

/// Returns the name of a check of the teeth without its number of turns.
fn averaged_kind(check: &str) -> Option<&str> {
    let (kind, turns) = check.rsplit_once('_').filter(|_| check.starts_with(TEETH))?;
    turns.parse::<u32>().ok().map(|_| kind)
}

/// Returns the edges in hertz of the octave that a check covers.
pub(super) fn octave_hz(check: &str) -> Option<[f64; 2]> {
    let centre: f64 = check.rsplit('_').next()?.strip_suffix("hz")?.parse().ok()?;
    Some([centre / SQRT_2, centre * SQRT_2])
}

/// Recognises a dead sensor or a loose mount from the noise floors.
///
/// A loose mount blocks high frequencies, noise and lines alike.
fn sensor_fault(checks: &[Deviation], lines_fell: Option<bool>) -> Option<SensorFault> {
    let is_noise = |d: &&Deviation| d.name.starts_with("ln_floor_") || d.name.starts_with("ln_rest_");
    let noise: Vec<&Deviation> = checks.iter().filter(is_noise).collect();
    if noise.len() < MIN_FLOORS {
        return None;
    }
    if noise.iter().all(|d| d.residual < DEAD_DROP) {
        return Some(SensorFault::Dead);
    }
    let floors = checks.iter().filter(|d| d.name.starts_with("ln_floor_"));
    let mut floors: Vec<(f64, f64)> =
        floors.filter_map(|d| Some((octave_hz(&d.name)?[0], d.residual))).collect();
    floors.sort_by(|a, b| a.0.total_cmp(&b.0));
    let ((_, low), (_, high)) = (floors.first()?, floors.last()?);
    (*high < LOOSE_LOSS && high - low < LOOSE_SLOPE && lines_fell != Some(false))
        .then_some(SensorFault::LooseMount)
}

#[cfg(test)]
mod tests {
    use flankwatch_signal::NotComputed;

    use super::*;

    fn deviations(kind: &str, residuals: &[f64]) -> Vec<Deviation> {
        let name = |i: usize| format!("{kind}_{}hz", 250 << i);
        let all = residuals.iter().enumerate();
        all.map(|(i, &residual)| Deviation { name: name(i).into(), residual, deviation: 0.05 }).collect()
    }

    fn judged(lines: &[f64], floors: &[f64], rests: &[f64]) -> Novelty {
        let mut checks = deviations("ln_floor", floors);
        checks.extend(deviations("ln_rest", rests));
        judge(
            &Features::default(),
            &[deviations("ln_mesh", lines), checks],
            20.0,
            RecordContext::default(),
            &mut Cusums::default(),
        )
    }

    #[test]
    fn sensor_faults_are_distinguished() {
        let fault = |lines: &[f64], floors: &[f64], rests: &[f64]| judged(lines, floors, rests).sensor_fault;
        assert_eq!(fault(&[0.7; 8], &[0.69; 4], &[0.71; 4]), None, "without a step");
        assert_eq!(fault(&[-9.0; 8], &[-9.0; 4], &[-8.0; 4]), Some(SensorFault::Dead));
        assert_eq!(
            fault(&[0.0; 8], &[0.1, 0.1, -1.0, -2.0], &[0.0, 0.0, -1.0, -2.0]),
            Some(SensorFault::LooseMount)
        );
        let bearing = judged(&[0.0; 8], &[0.0, 0.0, 0.5, 0.1], &[0.0, 0.2, 1.5, 0.3]);
        assert_eq!((bearing.sensor_fault, bearing.outside), (None, true));
        assert_eq!(bearing.largest_deviations[0].feature, "ln_rest_1000hz");
        let calm = judged(&[0.04; 8], &[-0.04; 4], &[0.02; 4]);
        assert!(!calm.outside && calm.p_value > 0.01);
    }

    /// Records that each deviate too little by themselves, and then a strong one.
    #[test]
    fn lasting_deviations_are_flagged_and_named() {
        let mut cusums = Cusums::default();
        let mut take = |tooth: f64, shaft: f64| {
            let checks =
                [("ln_tooth_worst", tooth), ("ln_shaft_1", shaft), ("ln_rest_1", 0.0), ("ln_rest_2", 0.01)];
            let checks =
                checks.map(|(name, residual)| Deviation { name: name.into(), residual, deviation: 0.05 });
            judge(
                &Features::default(),
                &[Vec::new(), checks.to_vec()],
                20.0,
                RecordContext::default(),
                &mut cusums,
            )
        };
        for _ in 0..20 {
            assert!(!take(-0.01, 0.02).outside);
        }
        let told: Vec<Novelty> = (0..10).map(|_| take(0.13, -0.02)).collect();
        assert!(!told[0].outside && told[9].outside, "{:?}", told[9]);
        assert_eq!(
            (told[9].suspected_fault, told[9].lasting.as_deref()),
            (Some(SuspectedFault::OneTooth), Some("ln_tooth_worst"))
        );
        assert!(told.windows(2).all(|pair| pair[0].p_value >= pair[1].p_value));
        let strong = take(0.0, 1.0);
        assert_eq!((strong.suspected_fault, strong.lasting), (Some(SuspectedFault::ShaftLines), None));
        for _ in 0..30 {
            take(0.0, 0.0);
        }
        assert!(!take(0.0, 0.0).outside);
    }

    /// Eight lines that are off by 1.8 standard deviations, record after record: a p-value of 0.002 that
    /// lasts.
    #[test]
    fn a_lasting_poor_fit_is_flagged() {
        let mut cusums = Cusums::default();
        let mut take = |off: f64| {
            judge(
                &Features::default(),
                &[deviations("ln_mesh", &[off; 8]), deviations("ln_floor", &[0.01; 4])],
                20.0,
                RecordContext::default(),
                &mut cusums,
            )
        };
        let poor: Vec<Novelty> = (0..8).map(|_| take(0.125)).collect();
        assert!(!poor[0].outside && poor[7].outside, "{} {}", poor[0].score, poor[7].score);
        assert_eq!((poor[7].lasting.as_deref(), poor[7].suspected_fault), (Some("lines"), None));
        let good: Vec<Novelty> = (0..20).map(|_| take(0.04)).collect();
        assert!(!good[19].outside);
    }

    /// Later records are shorter, and fill fewer turns.
    #[test]
    fn a_tooth_check_over_other_turns_continues_and_does_not_last_forever() {
        let mut cusums = Cusums::default();
        let mut take = |turns: u32, residual: f64| {
            let tooth =
                Deviation { name: format!("ln_tooth_worst_{turns}").into(), residual, deviation: 0.05 };
            let mut checks = deviations("ln_floor", &[0.01; 4]);
            checks.push(tooth);
            let lines = deviations("ln_mesh", &[0.01; 8]);
            judge(&Features::default(), &[lines, checks], 20.0, RecordContext::default(), &mut cusums)
        };
        assert!((0..6).map(|_| take(128, 0.15)).last().unwrap().outside);
        let shorter = take(32, 0.15);
        assert_eq!(shorter.lasting.as_deref(), Some("ln_tooth_worst_32"));
        assert!(!(0..20).map(|_| take(32, 0.0)).last().unwrap().outside);
    }

    /// The machine stands still in every other record, which has no lines.
    #[test]
    fn a_poor_fit_lasts_over_records_without_lines() {
        let mut cusums = Cusums::default();
        let mut take = |lines: &[f64]| {
            judge(
                &Features::default(),
                &[deviations("ln_mesh", lines), deviations("ln_floor", &[0.01; 4])],
                20.0,
                RecordContext::default(),
                &mut cusums,
            )
        };
        let poor: Vec<Novelty> = (0..16).map(|n| take(if n % 2 == 0 { &[0.125; 8] } else { &[] })).collect();
        assert!(!poor[0].outside && poor[14].outside, "{} {}", poor[0].score, poor[14].score);
    }

    #[test]
    fn clipped_samples_are_a_sensor_fault() {
        let record = Features { fault: Some(NotComputed::Clipped), ..Features::default() };
        let judged =
            judge(&record, &[Vec::new(), Vec::new()], 20.0, RecordContext::default(), &mut Cusums::default());
        assert_eq!((judged.sensor_fault, judged.outside), (Some(SensorFault::Clipped), true));
    }

    /// A record of a failing bearing that reaches the end of the converter's range.
    #[test]
    fn clipping_after_a_lasting_deviation_is_no_sensor_fault() {
        let mut cusums = Cusums::default();
        let mut take = |rest: f64, fault: Option<NotComputed>| {
            let record = Features { fault, ..Features::default() };
            let checks = deviations("ln_rest", &[rest; 8]);
            judge(&record, &[Vec::new(), checks], 20.0, RecordContext::default(), &mut cusums).sensor_fault
        };
        assert_eq!(take(0.0, Some(NotComputed::Clipped)), Some(SensorFault::Clipped));
        assert!((0..5).all(|_| take(1.0, None).is_none()));
        assert_eq!(take(1.2, Some(NotComputed::Clipped)), None);
        assert_eq!(take(1.2, Some(NotComputed::Gaps)), Some(SensorFault::Gaps));
    }
}
