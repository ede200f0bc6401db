//! `flankwatch evaluate`: what the wear estimate is worth, on simulated runs to failure whose true wear is
//! known.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use plotly::common::{Line, Mode, Title};
use plotly::layout::Axis;
use plotly::{Layout, Plot, Scatter};

use super::ensemble::Ensembles;
use super::library::progress_bar;
use super::recorded_runs;
use super::{CliError, output, pair_file};
use crate::evaluation::{Case, CaseGroup, EvaluationSettings, NOMINAL, RunOptions, Score, evaluate};
use crate::library::{EnsembleSettings, VARIANTS};

/// Which cases are run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Cases {
    /// Wear and faults
    All,
    /// Wear of the library's own physics and of others
    Wear,
    /// Faults that are not wear, and what is healthy
    Faults,
}

impl Cases {
    fn hold(self, case: &Case) -> bool {
        match self {
            Self::All => true,
            Self::Wear => case.aim.group() == CaseGroup::Wear,
            Self::Faults => case.aim.group() == CaseGroup::Faults,
        }
    }
}

/// Arguments of `flankwatch evaluate`.
#[derive(Debug, Args)]
pub(super) struct EvaluateArgs {
    /// Runs of each case
    #[arg(long, default_value_t = EvaluationSettings::default().runs)]
    runs: usize,
    /// Seed of paths, noise and operating points
    #[arg(long, default_value_t = EvaluationSettings::default().seed)]
    seed: u64,
    /// Records of each run
    #[arg(long, default_value_t = EvaluationSettings::default().records)]
    records: usize,
    /// Wear states that the runs of a case are drawn from
    #[arg(long, default_value_t = EvaluationSettings::default().states)]
    states: usize,
    /// Which cases are run
    #[arg(long, value_enum, default_value_t = Cases::All)]
    cases: Cases,
    /// Only cases whose name holds this text
    #[arg(long)]
    case: Option<String>,
    /// Pairs like the described one that the estimate is made with; 0 for the described pair alone
    #[arg(long, default_value_t = EnsembleSettings::default().members)]
    members: usize,
    /// The gear pair; the pair of Shen et al. 2022 where not given
    #[arg(long)]
    pair: Option<PathBuf>,
    /// Score recorded runs in place of simulated ones: folders with WAV files in the order of their names,
    /// one a record, and a truth.csv with a column wear_um; channels are scored one by one and together
    #[arg(long, num_args = 1.., value_name = "FOLDER")]
    recorded: Vec<PathBuf>,
    /// Score the estimate on runs of this many members of the ensemble in place of simulated ones, each with
    /// all others
    #[arg(long, value_name = "MEMBERS", conflicts_with = "recorded")]
    leave_one_out: Option<usize>,
    /// With --recorded: leave this many records in the middle of each run out
    #[arg(long, default_value_t = 0, requires = "recorded")]
    gap: usize,
    /// With --recorded: tell the estimator the true depth half-way, as an inspection with this error in µm
    #[arg(long, requires = "recorded")]
    inspection_um: Option<f64>,
    /// With --recorded: score these answers in place of the estimator's: JSON, by run a list of median, 5 %
    /// and 95 % quantile in µm, or null, one a record
    #[arg(long, requires = "recorded")]
    answers: Option<PathBuf>,
    /// With --recorded: print JSON
    #[arg(long, requires = "recorded")]
    json: bool,
    /// Write tables and plots to this HTML file, which needs no other
    #[arg(long)]
    out: Option<PathBuf>,
    /// Folder of the service's data; libraries are kept in its `libraries`
    #[arg(long, default_value = "flankwatch-data")]
    data_dir: PathBuf,
}

/// Runs the command.
pub(super) fn run(args: &EvaluateArgs) -> Result<(), CliError> {
    if args.runs == 0 || args.records < 40 || args.states < 20 {
        return Err(CliError::Argument(format!(
            "--runs is {}, --records {} and --states {}, expected at least 1, 40 and 20",
            args.runs, args.records, args.states
        )));
    }
    let pair = pair_file::read(args.pair.as_deref())?;
    let ensembles = Ensembles::new(&args.data_dir, args.members);
    if let Some(count) = args.leave_one_out {
        let ensemble = ensembles.of(&pair)?;
        if count == 0 || ensemble.members().len() < 2 * ensemble.variants() {
            return Err(CliError::Argument(format!(
                "--leave-one-out is {count} with --members {}, expected at least 1 and {}",
                args.members,
                2 * VARIANTS
            )));
        }
        return recorded_runs::run_members(&ensemble, count, RunOptions::default());
    }
    if !args.recorded.is_empty() {
        let ensemble = || ensembles.of(&pair);
        let trial = RunOptions { gap: args.gap, inspection_um: args.inspection_um };
        return recorded_runs::run(
            &args.recorded,
            &pair,
            &ensemble,
            trial,
            args.answers.as_deref(),
            args.json,
        );
    }
    let settings =
        EvaluationSettings { runs: args.runs, records: args.records, states: args.states, seed: args.seed };
    let wanted =
        |case: &Case| args.cases.hold(case) && args.case.as_ref().is_none_or(|text| case.name.contains(text));
    let all = Case::all(&pair);
    let cases: Vec<Case> = all.iter().filter(|case| wanted(case)).cloned().collect();
    if cases.is_empty() {
        let names: Vec<&str> =
            all.iter().filter(|case| args.cases.hold(case)).map(|case| case.name.as_str()).collect();
        return Err(CliError::Argument(format!(
            "--case is {:?}, which no case's name holds, expected a part of one of: {}",
            args.case.as_deref().unwrap_or_default(),
            names.join(", ")
        )));
    }
    let bar = progress_bar(cases.len() as u64, "cases");
    let mut scores = Vec::with_capacity(cases.len());
    output::print(&header())?;
    for case in &cases {
        let ensemble = ensembles.of(&case.described)?;
        let score = evaluate(case, &ensemble, &settings)?;
        bar.suspend(|| output::print(&row(&score)))?;
        scores.push(score);
        bar.inc(1);
    }
    bar.finish_and_clear();
    output::print(&beside(&scores))?;
    if let Some(path) = &args.out {
        output::write_file(path, page(&scores, &settings).as_bytes())?;
    }
    Ok(())
}

fn header() -> String {
    format!(
        "{:<24} {:>7} {:>7} {:>7} {:>8} {:>7} {:>7} {:>8} {:>8} {:>9}  {}\n",
        "case",
        "error",
        "90 % <",
        "bias",
        "covered",
        "width",
        "rank",
        "flagged",
        "found",
        "crossing",
        "named"
    )
}

fn row(score: &Score) -> String {
    let told = score.estimates > 0;
    let number = |value: f64, digits: usize| {
        if told { format!("{value:.digits$}") } else { "-".to_owned() }
    };
    let named = score.named.as_ref();
    let named =
        named.map_or_else(|| "-".to_owned(), |(name, part)| format!("{name} ({:.0} %)", 100.0 * part));
    let part = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.3}"));
    format!(
        "{:<24} {:>7} {:>7} {:>7} {:>8} {:>7} {:>7} {:>8.4} {:>8} {:>9}  {}\n",
        score.case,
        number(score.mean_error_um, 1),
        number(score.error_quantiles_um[1], 1),
        number(score.bias_um, 1),
        number(score.coverage, 3),
        number(score.width_um, 1),
        part(score.rank_correlation),
        score.false_flags,
        part(score.found),
        part(score.prognosis.map(|(part, _)| part)),
        named,
    )
}

/// What single indicators make of the same runs.
fn beside(scores: &[Score]) -> String {
    let mut text = format!(
        "\n{:<24} {:>8} {:>8} {:>8} {:>8}   {:<26} {}\n",
        "rank correlation of",
        "wear",
        "rms",
        "kurtosis",
        "omx",
        "depth at twice the rms",
        "depth at half wear"
    );
    for score in scores {
        let (Some(wear), Some([rms, kurtosis, omx])) =
            (score.rank_correlation, score.single_rank_correlation)
        else {
            continue;
        };
        let alarm = |depths: Option<[f64; 3]>| {
            depths.map_or_else(
                || "-".to_owned(),
                |[low, median, high]| format!("{median:.0} ({low:.0} to {high:.0}) µm"),
            )
        };
        text += &format!(
            "{:<24} {wear:>8.3} {rms:>8.3} {kurtosis:>8.3} {omx:>8.3}   {:<26} {}\n",
            score.case,
            alarm(score.rms_alarm_um),
            alarm(score.wear_alarm_um)
        );
    }
    text
}

fn page(scores: &[Score], settings: &EvaluationSettings) -> String {
    let mut plot = Plot::new();
    let ideal = Scatter::new(vec![0.0, 1.0], vec![0.0, 1.0]).mode(Mode::Lines).name("ideal");
    plot.add_trace(ideal.line(Line::new().color("#000000").width(1.0)));
    for score in scores.iter().filter(|score| score.rank_correlation.is_some()) {
        plot.add_trace(
            Scatter::new(NOMINAL.to_vec(), score.calibration.clone())
                .mode(Mode::LinesMarkers)
                .name(&score.case),
        );
    }
    let axis = |title: &str| Axis::new().title(Title::with_text(title)).range(vec![0.0, 1.0]);
    plot.set_layout(
        Layout::new()
            .title(Title::with_text("Calibration: how often the central interval holds the truth"))
            .height(560)
            .x_axis(axis("nominal coverage"))
            .y_axis(axis("actual coverage")),
    );
    let mut widths = Plot::new();
    let worn: Vec<&Score> = scores.iter().filter(|score| score.rank_correlation.is_some()).collect();
    let names: Vec<String> = worn.iter().map(|score| score.case.clone()).collect();
    for (i, name) in ["median", "90 %", "99 %"].into_iter().enumerate() {
        let values: Vec<f64> = worn.iter().map(|score| score.error_quantiles_um[i]).collect();
        widths.add_trace(Scatter::new(names.clone(), values).mode(Mode::Markers).name(name));
    }
    widths.set_layout(
        Layout::new()
            .title(Title::with_text("Quantiles of the absolute error"))
            .height(460)
            .y_axis(Axis::new().title(Title::with_text("µm"))),
    );
    let mut table = header();
    scores.iter().for_each(|score| table += &row(score));
    table += &beside(scores);
    let script = Plot::offline_js_sources();
    format!(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><title>flankwatch evaluation</title>{script}</head><body>\
         <h1>Wear estimation on simulated runs</h1><p>{} runs a case of {} records, seed {}. Errors and widths in µm of greatest wear depth; \
         covered: part of the records whose 90 % interval holds the truth; flagged: part of the records without a fault that were flagged; found: \
         part of the runs flagged within 10 records of a fault; named: what the fault's flagged records were called most often; crossing: part of the prognoses from half of life on whose 90 % interval holds \
         the crossing of 80 % of the library's depth.</p><pre>{table}</pre>{}{}</body></html>",
        settings.runs,
        settings.records,
        settings.seed,
        plot.to_inline_html(None),
        widths.to_inline_html(None),
    )
}
