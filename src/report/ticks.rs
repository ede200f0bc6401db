//! Axis ticks at round values.

use jiff::Timestamp;

/// A position on an axis and its label.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tick {
    pub(super) at: f64,
    pub(super) label: String,
}

/// Permitted spacings of ticks on a time axis in seconds.
const STEPS_S: [f64; 19] = [
    1.0,
    5.0,
    15.0,
    60.0,
    300.0,
    900.0,
    1800.0,
    3600.0,
    3.0 * 3600.0,
    6.0 * 3600.0,
    12.0 * 3600.0,
    86400.0,
    2.0 * 86400.0,
    7.0 * 86400.0,
    14.0 * 86400.0,
    30.0 * 86400.0,
    90.0 * 86400.0,
    182.0 * 86400.0,
    365.0 * 86400.0,
];

/// Returns about `count` ticks, spaced by 1, 2 or 5 times a power of ten.
pub(super) fn numbers(low: f64, high: f64, count: usize) -> Vec<Tick> {
    let rough = (high - low) / count.max(1) as f64;
    if !(rough > 0.0 && rough.is_finite()) {
        return Vec::new();
    }
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .map(|part| part * power)
        .find(|step| *step >= rough)
        .unwrap_or(10.0 * power);
    let decimals = (-step.log10().floor()).max(0.0) as usize;
    let greatest = low.abs().max(high.abs());
    let digits = (greatest.log10().floor() - step.log10().floor()).max(0.0) as usize;
    let label = |at: f64| {
        let at = if at == 0.0 { 0.0 } else { at };
        if step < 1e-4 || greatest >= 1e6 { format!("{at:.digits$e}") } else { format!("{at:.decimals$}") }
    };
    positions(low, high, step).map(|at| Tick { at, label: label(at) }).collect()
}

/// Returns about `count` ticks at round times; positions are seconds since 1970 UTC.
pub(super) fn times(low: f64, high: f64, count: usize) -> Vec<Tick> {
    let rough = (high - low) / count.max(1) as f64;
    let longest = STEPS_S[STEPS_S.len() - 1];
    let step =
        STEPS_S.into_iter().find(|step| *step >= rough).unwrap_or_else(|| longest * (rough / longest).ceil());
    let format = if step < 60.0 {
        "%H:%M:%S"
    } else if step < 86400.0 {
        "%m-%d %H:%M"
    } else {
        "%Y-%m-%d"
    };
    let label = |at: f64| {
        Timestamp::from_second(at as i64)
            .map_or_else(|_| String::new(), |time| time.strftime(format).to_string())
    };
    positions(low, high, step).map(|at| Tick { at, label: label(at) }).collect()
}

fn positions(low: f64, high: f64, step: f64) -> impl Iterator<Item = f64> {
    let first = (low / step - 1e-9).ceil();
    let last = (high / step + 1e-9).floor();
    let count = if last >= first { (last - first) as usize + 1 } else { 0 };
    (0..count.min(100)).map(move |n| (first + n as f64) * step)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(ticks: &[Tick]) -> Vec<&str> {
        ticks.iter().map(|tick| tick.label.as_str()).collect()
    }

    #[test]
    fn numbers_are_round() {
        assert_eq!(labels(&numbers(0.0, 243.0, 5)), ["0", "50", "100", "150", "200"]);
        assert_eq!(labels(&numbers(-0.13, 0.11, 4)), ["-0.1", "0.0", "0.1"]);
        assert!(numbers(1.0, 1.0, 5).is_empty());
        // Small steps and large numbers have as many digits as tell them apart.
        assert_eq!(labels(&numbers(0.0123, 0.0124, 4)), ["1.230e-2", "1.235e-2", "1.240e-2"]);
        assert_eq!(labels(&numbers(-4e6, 0.0, 4)), ["-4e6", "-3e6", "-2e6", "-1e6", "0e0"]);
    }

    #[test]
    fn times_are_round_and_utc() {
        let at = |time: &str| time.parse::<Timestamp>().unwrap().as_second() as f64;
        let ticks = times(at("2026-03-01T07:50:00Z"), at("2026-03-01T10:10:00Z"), 3);
        assert_eq!(labels(&ticks), ["03-01 08:00", "03-01 09:00", "03-01 10:00"]);
    }
}
