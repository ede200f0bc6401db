//! Tables of scores on recorded runs.

use crate::evaluation::{ForecastScore, RunScore, ScoreAfter, SingleIndicators};

/// Formats the means of coverage, error and width over the runs that have estimates.
pub(super) fn means(what: &str, scores: Vec<[f64; 3]>) -> String {
    let mean = |which: usize| {
        let sum: f64 = scores.iter().map(|score| score[which]).sum();
        (!scores.is_empty()).then(|| sum / scores.len() as f64)
    };
    format!(
        "{what}: covered {}, error {} µm, width {} µm\n",
        or_dash(mean(0), 3),
        or_dash(mean(1), 1),
        or_dash(mean(2), 1)
    )
}

/// Formats a number, or a dash without one.
fn or_dash(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

/// Formats the scores of forecasts; empty if no run has any.
pub(super) fn forecast_table(scores: &[RunScore]) -> String {
    let scored: Vec<(&str, &ForecastScore)> =
        scores.iter().filter_map(|score| Some((score.run.as_str(), score.forecasts.as_ref()?))).collect();
    if scored.is_empty() {
        return String::new();
    }
    let mut text = format!(
        "\n{:<24} {:>9} {:>8} {:>8} {:>12} {:>15}\n",
        "time to the limit", "given", "holds", "too late", "median/true", "late end/true"
    );
    let counts = |[given, records, holding, too_late]: [usize; 4]| {
        let part = |count: usize| or_dash((given > 0).then(|| count as f64 / given as f64), 3);
        format!("{:>9} {:>8} {:>8}", format!("{given}/{records}"), part(holding), part(too_late))
    };
    let of = |score: &ForecastScore| [score.given, score.records, score.holding, score.too_late];
    let mut all = [0; 4];
    for (run, score) in &scored {
        all.iter_mut().zip(of(score)).for_each(|(sum, count)| *sum += count);
        text += &format!(
            "{run:<24} {} {:>12} {:>15}\n",
            counts(of(score)),
            or_dash(score.median_ratio, 2),
            or_dash(score.late_ratio, 1),
        );
    }
    text + &format!("{:<24} {}\n", "all forecasts", counts(all))
}

/// Formats the results of single indicators on the same runs.
pub(super) fn indicator_table(scores: &[SingleIndicators]) -> String {
    let mut text = format!(
        "\n{:<24} {:>20} {:>26} {:>10}\n",
        "single indicators", "rms doubled, at µm", "regression on OMX, error", "its rank"
    );
    for score in scores {
        text += &format!(
            "{:<24} {:>20} {:>26} {:>10}\n",
            score.run,
            or_dash(score.rms_alarm_um, 0),
            or_dash(score.omx_error_um, 1),
            or_dash(score.omx_rank, 3),
        );
    }
    text
}

pub(super) fn header() -> String {
    format!(
        "{:<24} {:>9} {:>8} {:>8} {:>8} {:>7} {:>7} {:>7} {:>7} {:>8} {:>16}  {}\n",
        "run",
        "estimated",
        "flagged",
        "covered",
        "longest",
        "rank",
        "error",
        "bias",
        "width",
        "narrow",
        "after",
        "last"
    )
}

pub(super) fn row(score: &RunScore) -> String {
    let text_or_dash = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
    let after = score.after.as_ref().map(|ScoreAfter { mean_error_um, width_um, coverage }| {
        format!("{mean_error_um:.1} {width_um:.1} {coverage:.3}")
    });
    let last = score.last.map(|[median, low, high]| format!("{median:.0} [{low:.0}, {high:.0}]"));
    format!(
        "{:<24} {:>9} {:>8} {:>8} {:>8} {:>7} {:>7} {:>7} {:>7} {:>8} {:>16}  {}\n",
        score.run,
        format!("{}/{}", score.estimated, score.records),
        score.flagged,
        or_dash(score.coverage, 3),
        score.longest_miss,
        or_dash(score.rank, 3),
        or_dash(score.mean_error_um, 1),
        text_or_dash(score.bias_um.map(|um| format!("{um:+.1}"))),
        or_dash(score.width_um, 1),
        format!("{}/{}", score.narrow[1], score.narrow[0]),
        text_or_dash(after),
        text_or_dash(last),
    )
}
