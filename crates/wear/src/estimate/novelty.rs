//! Whether wear explains a record at all, and if not, whether the sensor or the machine is the reason.

mod signs;

use std::f64::consts::SQRT_2;

use serde::{Deserialize, Serialize};

use self::signs::TEETH;
pub use self::signs::{MachineSign, SensorFault};
use super::cusum::Cusums;
use super::deviation::{Deviation, chi_square_score, normal_tail};
use flankwatch_signal::{EnvelopeLine, Features, NotComputed};

/// Below this p-value a record is not explained.
pub(super) const MIN_P_VALUE: f64 = 1e-4;

/// Deviations are correlated: the sum of squares is this much wider than that of independent ones.
const INFLATION_LINES: f64 = 2.0;
const INFLATION_CHECKS: f64 = 1.6;

/// Weight of a check's deviation where it has fallen: a fault of the machine adds energy beside its mesh lines,
/// while wear, load and speed may take some away. What a sensor loses is judged at full weight.
const FALLEN_WEIGHT: f64 = 0.5;

/// The same where no mesh lines are compared: nothing else then tells a fault from a machine that runs down.
const FALLEN_WEIGHT_WITHOUT_LINES: f64 = 0.25;

/// Checks that are followed over records: faults of one tooth and of the shaft raise them, and wear does not.
const CUSUM_CHECKS: [&str; 2] = [TEETH, "ln_shaft_"];

/// Their scatter is larger than the baseline's by this factor: they are no normal deviates.
const CUSUM_SCATTER: f64 = 1.25;

/// The fit as a whole in the charts: that of the lines to the best state, and that of what wear hardly moves.
const OVERALL_FIT: [&str; 2] = ["lines", "checks"];

/// What a poor fit has to exceed beyond a chart's own allowance to count, in standard deviations: what is
/// wrong with a library is wrong in every record too. With twice the described mesh damping 1.5 % of records
/// are flagged without these two charts, 2.8 % with 0.8, 8 % with 0.5; a broken tooth that moves the lines
/// alone is seen after 3 to 6 records with 0.8, hardly at all with 1.
const FIT_ALLOWANCE: f64 = 0.8;

/// The same where no library is compared that could be wrong.
const FIT_ALLOWANCE_WITHOUT_LINES: f64 = 0.5;

/// A dead sensor's noise floors lie this logarithm below the baseline's (a factor of 50).
const DEAD_DROP: f64 = -3.9;

/// A loose mount loses at least this logarithm (a factor of 4, as beyond twice the resonance of a mass on a
/// spring) in the highest band ...
const LOOSE_LOSS: f64 = -1.4;

/// ... more than in the lowest one.
const LOOSE_SLOPE: f64 = -0.7;

/// Fewest noise floors that a fault of the sensor is told from.
const MIN_FLOORS: usize = 4;

/// So many standard deviations of a check of the teeth are one tooth's doing, whatever else has grown.
const MIN_TOOTH_SCORE: f64 = 4.0;

/// What has grown by fewer standard deviations is no sign of anything where the record does not deviate by
/// itself.
const MIN_GROWN_SCORE: f64 = 3.0;

/// How one feature deviates from what the best state expects.
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

/// How well the best state explains a record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Novelty {
    /// Probability that a record of the best state deviates as much as this one; low where wear does not
    /// explain it.
    pub p_value: f64,
    /// −log₁₀ of the same, at most 30: what an alarm may be set on.
    pub score: f64,
    /// Whether the record lies outside of what the library explains.
    pub outside: bool,
    /// What is wrong with the sensor, where that is the reason.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor_fault: Option<SensorFault>,
    /// What it looks like, where a check that wear hardly moves has grown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub machine_sign: Option<MachineSign>,
    /// What else it may be, the likelier first: checks of other kinds that have grown at least half as much.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub also: Vec<MachineSign>,
    /// The octave in hertz whose energy has grown most, where energy is the sign.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub band_hz: Option<[f64; 2]>,
    /// The strongest line of the record's envelope spectrum, where impulses are the sign and it stands out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub envelope_line: Option<EnvelopeLine>,
    /// The check that has deviated for several records, where that says more than this record alone; `lines`
    /// or `checks` where it is the fit as a whole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lasting: Option<String>,
    /// The features that deviate most.
    pub most: Vec<FeatureDeviation>,
}

impl Novelty {
    /// −log₁₀ of a p-value, at most 30.
    pub(super) fn score_of(p_value: f64) -> f64 {
        (-p_value.max(1e-30).log10()).max(0.0)
    }
}

/// What a record shows beside its deviations from the best state.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct RecordContext {
    /// Natural logarithm of the factor by which all values moved at once, where they did.
    pub(super) gain: Option<f64>,
    /// Whether the lines of the highest octave fell as its noise floor did, as far as there are any.
    pub(super) lines_fell: Option<bool>,
    /// Whether its kurtosis stands out of the healthy ones.
    pub(super) impulsive: bool,
}

/// Judges a record by its deviations from the best state: of lines, of what wear hardly moves, and by what
/// has lasted over the records before.
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
    // What has been unlike the healthy records and now reaches the end of the range is no fault of the sensor.
    let has_lasted = cusums.highest().is_some_and(|(_, p)| p < MIN_P_VALUE);
    let sensor_fault = match record.fault {
        Some(NotComputed::Constant) => Some(SensorFault::Dead),
        Some(NotComputed::Clipped) if !has_lasted => Some(SensorFault::Clipped),
        Some(NotComputed::Gaps) => Some(SensorFault::Gaps),
        _ if p_with_falls < MIN_P_VALUE => {
            sensor_fault(checks, context.lines_fell).or(context.gain.map(|_| SensorFault::GainChanged))
        }
        _ => None,
    };
    // A fault of the sensor says nothing of the machine.
    if sensor_fault.is_none() {
        let followed = checks.iter().filter(|d| CUSUM_CHECKS.iter().any(|kind| d.name.starts_with(kind)));
        let followed =
            followed.map(|d| (d.name.as_str(), d.normal_score(freedom).copysign(d.residual) / CUSUM_SCATTER));
        let whole = OVERALL_FIT.into_iter().zip([z_lines, z_checks].map(|z| z - allowance));
        cusums.update(followed.chain(whole));
    }
    let lasting = cusums.highest().filter(|_| sensor_fault.is_none());
    let p_value = lasting.map_or(p_record, |(_, p)| p.min(p_record));
    let outside = p_value < MIN_P_VALUE;
    // What a record says by itself comes before what has lasted.
    let by_itself = if sensor_fault.is_none() && p_checks < MIN_P_VALUE { most_grown(checks) } else { None };
    let lasting = lasting.filter(|(_, p)| by_itself.is_none() && *p < MIN_P_VALUE);
    let sign_of = |check: &str| MachineSign::of(check, context.impulsive);
    // Where the fit as a whole has been poor, what has grown is what this record shows.
    let whole = |check: &str| {
        let grown = OVERALL_FIT.contains(&check).then(|| most_grown(checks)).flatten();
        grown.filter(|grown| grown.score() > MIN_GROWN_SCORE)
    };
    let check = by_itself.or_else(|| {
        let (check, _) = lasting?;
        whole(check).or_else(|| checks.iter().find(|d| d.name == check))
    });
    // What one tooth does is heard between the mesh lines too, in some records more than over its own pitch.
    let tooth = cusums.highest_of(TEETH).filter(|(_, p)| *p < MIN_P_VALUE);
    let tooth = tooth.and_then(|(tooth, _)| checks.iter().find(|d| d.name == tooth));
    let check = check.map(|check| tooth.filter(|tooth| tooth.residual > 0.0).unwrap_or(check));
    let machine_sign = check.and_then(|check| sign_of(&check.name));
    let mut most: Vec<&Deviation> = lines.iter().chain(checks).collect();
    most.sort_by(|a, b| b.score().abs().total_cmp(&a.score().abs()));
    Novelty {
        p_value,
        score: Novelty::score_of(p_value),
        outside: outside || sensor_fault.is_some(),
        sensor_fault,
        machine_sign,
        also: check.map_or_else(Vec::new, |check| also(checks, check, sign_of)),
        band_hz: check.and_then(|check| octave_hz(&check.name)),
        envelope_line: record
            .envelope_line
            .clone()
            .filter(|_| machine_sign == Some(MachineSign::ImpulsiveEnergy)),
        lasting: lasting.map(|(check, _)| check.to_owned()),
        most: most
            .into_iter()
            .take(3)
            .map(|d| FeatureDeviation {
                feature: d.name.clone(),
                ln_ratio: d.residual,
                deviations: d.score(),
            })
            .collect(),
    }
}

/// The check that has deviated most, where it has grown; one of the teeth's before others where it stands out
/// by itself, as what one tooth does is heard between the mesh lines too.
fn most_grown(checks: &[Deviation]) -> Option<&Deviation> {
    let teeth = checks.iter().filter(|d| d.name.starts_with(TEETH) && d.score() > MIN_TOOTH_SCORE);
    if let Some(tooth) = teeth.max_by(|a, b| a.score().total_cmp(&b.score())) {
        return Some(tooth);
    }
    let most = checks.iter().max_by(|a, b| a.score().abs().total_cmp(&b.score().abs()))?;
    (most.residual > 0.0).then_some(most)
}

/// The signs beside the one of `most` of checks that have grown at least half as much.
fn also(
    checks: &[Deviation],
    most: &Deviation,
    sign_of: impl Fn(&str) -> Option<MachineSign>,
) -> Vec<MachineSign> {
    let mut grown: Vec<&Deviation> =
        checks.iter().filter(|d| d.score() > MIN_GROWN_SCORE.max(0.5 * most.score())).collect();
    grown.sort_by(|a, b| b.score().total_cmp(&a.score()));
    let mut signs: Vec<MachineSign> = sign_of(&most.name).into_iter().collect();
    for sign in grown.into_iter().filter_map(|d| sign_of(&d.name)) {
        if !signs.contains(&sign) {
            signs.push(sign);
        }
    }
    signs.into_iter().skip(1).collect()
}

/// The edges of the octave that a check is about.
pub(super) fn octave_hz(check: &str) -> Option<[f64; 2]> {
    let centre: f64 = check.rsplit('_').next()?.strip_suffix("hz")?.parse().ok()?;
    Some([centre / SQRT_2, centre * SQRT_2])
}

/// A dead sensor or a loose mount, from the noise floors.
///
/// Through a loose mount nothing passes at high frequencies, neither noise nor lines.
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
    use super::*;

    fn deviations(kind: &str, residuals: &[f64]) -> Vec<Deviation> {
        let name = |i: usize| format!("{kind}_{}hz", 250 << i);
        let all = residuals.iter().enumerate();
        all.map(|(i, &residual)| Deviation { name: name(i), residual, deviation: 0.05 }).collect()
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
    fn sensor_faults_are_told_apart() {
        let fault = |lines: &[f64], floors: &[f64], rests: &[f64]| judged(lines, floors, rests).sensor_fault;
        assert_eq!(fault(&[0.7; 8], &[0.69; 4], &[0.71; 4]), None, "without a step");
        assert_eq!(fault(&[-9.0; 8], &[-9.0; 4], &[-8.0; 4]), Some(SensorFault::Dead));
        assert_eq!(
            fault(&[0.0; 8], &[0.1, 0.1, -1.0, -2.0], &[0.0, 0.0, -1.0, -2.0]),
            Some(SensorFault::LooseMount)
        );
        let bearing = judged(&[0.0; 8], &[0.0, 0.0, 0.5, 0.1], &[0.0, 0.2, 1.5, 0.3]);
        assert_eq!((bearing.sensor_fault, bearing.outside), (None, true));
        assert_eq!(bearing.most[0].feature, "ln_rest_1000hz");
        let calm = judged(&[0.04; 8], &[-0.04; 4], &[0.02; 4]);
        assert!(!calm.outside && calm.p_value > 0.01);
    }

    /// Records that each deviate too little by themselves, and then a strong one.
    #[test]
    fn what_lasts_is_told_and_named() {
        let mut cusums = Cusums::default();
        let mut take = |tooth: f64, shaft: f64| {
            let checks =
                [("ln_tooth_worst", tooth), ("ln_shaft_1", shaft), ("ln_rest_1", 0.0), ("ln_rest_2", 0.01)];
            let checks =
                checks.map(|(name, residual)| Deviation { name: name.to_owned(), residual, deviation: 0.05 });
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
            (told[9].machine_sign, told[9].lasting.as_deref()),
            (Some(MachineSign::OneTooth), Some("ln_tooth_worst"))
        );
        assert!(told.windows(2).all(|pair| pair[0].p_value >= pair[1].p_value));
        let strong = take(0.0, 1.0);
        assert_eq!((strong.machine_sign, strong.lasting), (Some(MachineSign::ShaftLines), None));
        for _ in 0..30 {
            take(0.0, 0.0);
        }
        assert!(!take(0.0, 0.0).outside);
    }

    /// Eight lines that are off by 1.8 standard deviations, record after record: a p-value of 0.002 that
    /// lasts.
    #[test]
    fn a_fit_that_stays_poor_is_told() {
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
        assert_eq!((poor[7].lasting.as_deref(), poor[7].machine_sign), (Some("lines"), None));
        let good: Vec<Novelty> = (0..20).map(|_| take(0.04)).collect();
        assert!(!good[19].outside);
    }

    #[test]
    fn faults_of_the_samples_speak_for_themselves() {
        let record = Features { fault: Some(NotComputed::Clipped), ..Features::default() };
        let judged =
            judge(&record, &[Vec::new(), Vec::new()], 20.0, RecordContext::default(), &mut Cusums::default());
        assert_eq!((judged.sensor_fault, judged.outside), (Some(SensorFault::Clipped), true));
    }

    /// A record of a failing bearing that reaches the end of the converter's range.
    #[test]
    fn a_machine_that_has_become_too_loud_for_its_sensor_is_no_fault_of_the_sensor() {
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
