//! Whether wear explains a record at all, and if not, whether the sensor or the machine is the reason.

use serde::{Deserialize, Serialize};

use super::chart::Charts;
use flankwatch_signal::{Absence, Features};

/// Below this p-value a record is not explained.
const LEAST_P_VALUE: f64 = 1e-4;

/// Deviations are correlated: the sum of squares is this much wider than that of independent ones.
const INFLATION_LINES: f64 = 2.0;
const INFLATION_CHECKS: f64 = 1.6;

/// Checks that are followed over records: faults of one tooth and of the shaft raise them, and wear does not.
const CHARTED: [&str; 2] = ["ln_tooth_", "ln_shaft_"];

/// Their scatter is larger than the baseline's by this factor: they are no normal deviates.
const CHARTED_SCATTER: f64 = 1.25;

/// The fit as a whole in the charts: that of the lines to the best state, and that of what wear hardly moves.
const WHOLE: [&str; 2] = ["lines", "checks"];

/// What a poor fit has to exceed beyond a chart's own allowance to count, in standard deviations: what is wrong with a library is wrong in
/// every record too. With twice the described mesh damping 1.5 % of records are flagged without these two charts, 2.8 % with 0.8, 8 % with 0.5; a
/// broken tooth that moves the lines alone is seen after 3 to 6 records with 0.8, hardly at all with 1.
const WHOLE_ALLOWANCE: f64 = 0.8;

/// A gain that changed moves everything by at least this logarithm ...
const LEAST_GAIN: f64 = 0.15;

/// ... and leaves no more than this part of the sum of squares.
const GAIN_LEAVES: f64 = 0.15;

/// A dead sensor's noise floors lie this logarithm below the baseline's (a factor of 50).
const DEAD: f64 = -3.9;

/// A loose mount loses at least this logarithm (a factor of 4, as beyond twice the resonance of a mass on a spring) in the highest band ...
const LOOSE_LOSS: f64 = -1.4;

/// ... more than in the lowest one.
const LOOSE_SLOPE: f64 = -0.7;

/// What is wrong with the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum SensorFault {
    /// No vibration comes through.
    Dead,
    /// The signal is cut off at the converter's limit.
    Clipped,
    /// Stretches of the record are missing.
    Gaps,
    /// Noise floors and what lies between the lines have all moved alike: sensitivity or gain has changed.
    GainChanged,
    /// High frequencies are lost, low ones are not: the sensor is loose.
    LooseMount,
}

impl SensorFault {
    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Dead => "the sensor gives no signal",
            Self::Clipped => "the signal is clipped",
            Self::Gaps => "samples are missing",
            Self::GainChanged => "all noise floors moved alike: the sensor's gain has changed",
            Self::LooseMount => "high frequencies are lost: the sensor's mount is loose",
        }
    }
}

/// What a record that wear does not explain looks like, where the sensor is not the reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum MachineSign {
    /// One tooth of the shaft has more between the mesh harmonics than the others.
    OneTooth,
    /// The shaft's own lines have grown.
    ShaftLines,
    /// Energy that belongs to no mesh harmonic has grown.
    BesideMesh,
}

impl MachineSign {
    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::OneTooth => "one tooth differs from the others: a crack or chip, not wear",
            Self::ShaftLines => "the shaft's own lines have grown: misalignment or unbalance, not wear",
            Self::BesideMesh => "energy that does not belong to the mesh has grown: a bearing or looseness, not wear",
        }
    }

    /// What a check that has grown is a sign of.
    fn of(check: &str) -> Option<Self> {
        let signs = [
            ("ln_tooth_", Self::OneTooth),
            ("ln_shaft_", Self::ShaftLines),
            ("ln_rest_", Self::BesideMesh),
            ("ln_band_", Self::BesideMesh),
            ("ln_floor_", Self::BesideMesh),
        ];
        signs.into_iter().find_map(|(kind, sign)| check.starts_with(kind).then_some(sign))
    }
}

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
    /// Probability that a record of the best state deviates as much as this one; low where wear does not explain it.
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
    /// The check that has deviated for several records, where that says more than this record alone; `lines` or `checks` where it is the fit as a
    /// whole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lasting: Option<String>,
    /// The features that deviate most.
    pub most: Vec<FeatureDeviation>,
}

/// One feature of a record against what was expected.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Deviation {
    pub(super) name: String,
    /// Measured less expected, in logarithms.
    pub(super) residual: f64,
    /// Standard deviation of what was expected.
    pub(super) deviation: f64,
}

/// Judges a record by its deviations from the best state: of lines, of what wear hardly moves, and by what has lasted over the records before.
pub(super) fn judge(record: &Features, [lines, checks]: &[Vec<Deviation>; 2], freedom: f64, charts: &mut Charts) -> Novelty {
    let squares = |deviations: &[Deviation]| -> f64 { deviations.iter().map(|d| normal_score(d, freedom).powi(2)).sum() };
    let z_lines = chi_square_score(squares(lines) / INFLATION_LINES, lines.len());
    let z_checks = chi_square_score(squares(checks) / INFLATION_CHECKS, checks.len());
    let (p_lines, p_checks) = (normal_tail(z_lines), normal_tail(z_checks));
    let p_record = (2.0 * p_lines.min(p_checks)).min(1.0);
    let sensor_fault = match record.fault {
        Some(Absence::Constant) => Some(SensorFault::Dead),
        Some(Absence::Clipped) => Some(SensorFault::Clipped),
        Some(Absence::Gaps) => Some(SensorFault::Gaps),
        _ if p_record < LEAST_P_VALUE => sensor_fault(checks),
        _ => None,
    };
    // A fault of the sensor says nothing of the machine.
    if sensor_fault.is_none() {
        let charted = checks.iter().filter(|d| CHARTED.iter().any(|kind| d.name.starts_with(kind)));
        let charted = charted.map(|d| (d.name.as_str(), normal_score(d, freedom).copysign(d.residual) / CHARTED_SCATTER));
        let whole = WHOLE.into_iter().zip([z_lines, z_checks].map(|z| z - WHOLE_ALLOWANCE));
        charts.update(charted.chain(whole));
    }
    let lasting = charts.highest().filter(|_| sensor_fault.is_none());
    let p_value = lasting.map_or(p_record, |(_, p)| p.min(p_record));
    let outside = p_value < LEAST_P_VALUE;
    // What a record says by itself comes before what has lasted.
    let by_itself = if sensor_fault.is_none() && p_checks < LEAST_P_VALUE {
        grown_most(checks)
    } else {
        None
    };
    let lasting = lasting.filter(|(_, p)| by_itself.is_none() && *p < LEAST_P_VALUE);
    let machine_sign = by_itself.or_else(|| lasting.and_then(|(check, _)| MachineSign::of(check)));
    let lasting = lasting.map(|(check, _)| check.to_owned());
    let mut most: Vec<&Deviation> = lines.iter().chain(checks).collect();
    most.sort_by(|a, b| (b.residual / b.deviation).abs().total_cmp(&(a.residual / a.deviation).abs()));
    Novelty {
        p_value,
        score: (-p_value.max(1e-30).log10()).max(0.0),
        outside: outside || sensor_fault.is_some(),
        sensor_fault,
        machine_sign,
        lasting,
        most: most
            .into_iter()
            .take(3)
            .map(|d| FeatureDeviation {
                feature: d.name.clone(),
                ln_ratio: d.residual,
                deviations: d.residual / d.deviation,
            })
            .collect(),
    }
}

/// What the check that has grown most is a sign of; none where that one has fallen.
fn grown_most(checks: &[Deviation]) -> Option<MachineSign> {
    let score = |d: &Deviation| d.residual / d.deviation;
    let most = checks.iter().max_by(|a, b| score(a).abs().total_cmp(&score(b).abs()))?;
    (most.residual > 0.0).then(|| MachineSign::of(&most.name)).flatten()
}

fn sensor_fault(checks: &[Deviation]) -> Option<SensorFault> {
    let of = |name: &str| checks.iter().find(|d| d.name == name).map(|d| d.residual);
    let floors: Vec<&Deviation> = checks
        .iter()
        .filter(|d| d.name.starts_with("ln_floor_") || d.name.starts_with("ln_rest_"))
        .collect();
    if floors.len() < 4 {
        return None;
    }
    if floors.iter().all(|d| d.residual < DEAD) {
        return Some(SensorFault::Dead);
    }
    if let (Some(low), Some(high)) = (of("ln_floor_1"), of("ln_floor_4"))
        && high < LOOSE_LOSS
        && high - low < LOOSE_SLOPE
    {
        return Some(SensorFault::LooseMount);
    }
    // One factor for all: weighted mean, and what it leaves. The lines are not asked: the best state takes a part of a gain for wear.
    let weight: f64 = floors.iter().map(|d| d.deviation.powi(-2)).sum();
    let gain = floors.iter().map(|d| d.residual * d.deviation.powi(-2)).sum::<f64>() / weight;
    let before: f64 = floors.iter().map(|d| (d.residual / d.deviation).powi(2)).sum();
    let after: f64 = floors.iter().map(|d| ((d.residual - gain) / d.deviation).powi(2)).sum();
    (gain.abs() > LEAST_GAIN && after < GAIN_LEAVES * before).then_some(SensorFault::GainChanged)
}

/// The size of a deviation of Student's t distribution as that of one of the normal distribution with about the same tail (Wallace 1959).
fn normal_score(deviation: &Deviation, freedom: f64) -> f64 {
    let t = deviation.residual / deviation.deviation;
    let z = (freedom * (t * t / freedom).ln_1p()).sqrt();
    z * (8.0 * freedom + 1.0) / (8.0 * freedom + 3.0)
}

/// The normal deviate with the tail of χ² of this many degrees of freedom above a value, after Wilson and Hilferty (1931).
fn chi_square_score(value: f64, freedom: usize) -> f64 {
    if freedom == 0 {
        return f64::NEG_INFINITY;
    }
    let part = 2.0 / (9.0 * freedom as f64);
    ((value / freedom as f64).cbrt() - (1.0 - part)) / part.sqrt()
}

/// The probability that a standard normal deviate is above `z`: ½ erfc(z/√2) by the continued fraction of Mills' ratio beyond 2, by the
/// series of Φ within.
fn normal_tail(z: f64) -> f64 {
    let density = (-0.5 * z * z).exp() / (2.0 * std::f64::consts::PI).sqrt();
    if z > 2.0 {
        let fraction = (1..=60).rev().fold(0.0, |rest, k| f64::from(k) / (z + rest));
        return density / (z + fraction);
    }
    if z < -2.0 {
        return 1.0 - normal_tail(-z);
    }
    let (mut term, mut sum) = (z, z);
    for k in 1..60 {
        term *= z * z / f64::from(2 * k + 1);
        sum += term;
    }
    0.5 - density * sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// SciPy: norm.sf.
    #[test]
    fn normal_tails_are_those_of_scipy() {
        for (z, expected) in [
            (-3.0, 0.9986501019683699),
            (-1.0, 0.8413447460685429),
            (0.0, 0.5),
            (1.96, 0.024997895148220435),
            (3.0, 0.0013498980316300933),
            (8.0, 6.220960574271785e-16),
        ] {
            assert!((normal_tail(z) / expected - 1.0).abs() < 1e-9, "{z}: {}", normal_tail(z));
        }
    }

    /// SciPy: chi2.sf(30, 10) = 8.5664e-4, chi2.sf(10, 10) = 0.44049, chi2.sf(40, 20) = 4.995e-3; Wilson and Hilferty's is within a tenth.
    #[test]
    fn chi_square_tails_are_near_those_of_scipy() {
        for (value, freedom, expected) in [(30.0, 10, 8.566412e-4), (10.0, 10, 0.440493), (40.0, 20, 4.995e-3)] {
            let got = normal_tail(chi_square_score(value, freedom));
            assert!((got / expected - 1.0).abs() < 0.1, "{value} {freedom}: {got}");
        }
        assert_eq!(normal_tail(chi_square_score(5.0, 0)), 1.0);
    }

    fn deviations(kind: &str, residuals: &[f64]) -> Vec<Deviation> {
        let name = |i: usize| format!("{kind}_{}", i + 1);
        let all = residuals.iter().enumerate();
        all.map(|(i, &residual)| Deviation {
            name: name(i),
            residual,
            deviation: 0.05,
        })
        .collect()
    }

    fn judged(lines: &[f64], floors: &[f64], rests: &[f64]) -> Novelty {
        let mut checks = deviations("ln_floor", floors);
        checks.extend(deviations("ln_rest", rests));
        judge(
            &Features::default(),
            &[deviations("ln_mesh", lines), checks],
            20.0,
            &mut Charts::default(),
        )
    }

    #[test]
    fn sensor_faults_are_told_apart() {
        let fault = |lines: &[f64], floors: &[f64], rests: &[f64]| judged(lines, floors, rests).sensor_fault;
        assert_eq!(fault(&[0.7; 8], &[0.69; 4], &[0.71; 4]), Some(SensorFault::GainChanged));
        assert_eq!(fault(&[-0.7; 8], &[-0.69; 4], &[-0.71; 4]), Some(SensorFault::GainChanged));
        assert_eq!(fault(&[-9.0; 8], &[-9.0; 4], &[-8.0; 4]), Some(SensorFault::Dead));
        assert_eq!(
            fault(&[0.0; 8], &[0.1, 0.1, -1.0, -2.0], &[0.0, 0.0, -1.0, -2.0]),
            Some(SensorFault::LooseMount)
        );
        let bearing = judged(&[0.0; 8], &[0.0, 0.0, 0.5, 0.1], &[0.0, 0.2, 1.5, 0.3]);
        assert_eq!((bearing.sensor_fault, bearing.outside), (None, true));
        assert_eq!(bearing.most[0].feature, "ln_rest_3");
        let calm = judged(&[0.04; 8], &[-0.04; 4], &[0.02; 4]);
        assert!(!calm.outside && calm.p_value > 0.01);
    }

    /// Records that each deviate too little by themselves, and then a strong one.
    #[test]
    fn what_lasts_is_told_and_named() {
        let mut charts = Charts::default();
        let mut take = |tooth: f64, shaft: f64| {
            let checks = [
                ("ln_tooth_worst", tooth),
                ("ln_shaft_1", shaft),
                ("ln_rest_1", 0.0),
                ("ln_rest_2", 0.01),
            ];
            let checks = checks.map(|(name, residual)| Deviation {
                name: name.to_owned(),
                residual,
                deviation: 0.05,
            });
            judge(&Features::default(), &[Vec::new(), checks.to_vec()], 20.0, &mut charts)
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

    /// Eight lines that are off by 1.8 standard deviations, record after record: a p-value of 0.002 that lasts.
    #[test]
    fn a_fit_that_stays_poor_is_told() {
        let mut charts = Charts::default();
        let mut take = |off: f64| {
            judge(
                &Features::default(),
                &[deviations("ln_mesh", &[off; 8]), deviations("ln_floor", &[0.01; 4])],
                20.0,
                &mut charts,
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
        let record = Features {
            fault: Some(Absence::Clipped),
            ..Features::default()
        };
        let judged = judge(&record, &[Vec::new(), Vec::new()], 20.0, &mut Charts::default());
        assert_eq!((judged.sensor_fault, judged.outside), (Some(SensorFault::Clipped), true));
    }
}
