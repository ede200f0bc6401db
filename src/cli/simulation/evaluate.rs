//! `flankwatch evaluate`: scores the wear estimate on simulated runs to failure with known wear.

use std::iter;
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde_json::json;

use super::ensemble::{Ensembles, parse_members};
use super::library::progress_bar;
use super::recorded_runs;
use super::{pair_file, plot};
use crate::cli::output_check::{OutputKind, check_apart, check_result};
use crate::cli::{CliError, output};
use crate::evaluation::{
    Case, CaseGroup, EvaluationSettings, LeftOutRun, NOMINAL, RunOptions, Score, evaluate,
};
use crate::library::{EnsembleSettings, VARIANTS};

/// Most records in a run of a member that is left out; all runs are in memory.
const MAX_LEFT_OUT_RECORDS: usize = 20_000;

/// Groups of cases.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Cases {
    /// Wear and faults
    All,
    /// Wear, by the library's physics and by other physics
    Wear,
    /// Faults other than wear, and healthy machines
    Faults,
}

impl Cases {
    fn contains(self, case: &Case) -> bool {
        match self {
            Self::All => true,
            Self::Wear => case.aim.group() == CaseGroup::Wear,
            Self::Faults => case.aim.group() == CaseGroup::Faults,
        }
    }
}

/// Arguments of `flankwatch evaluate`.
#[derive(Debug, Args)]
pub(in crate::cli) struct EvaluateArgs {
    /// Number of runs per case
    #[arg(long, default_value_t = EvaluationSettings::default().runs, conflicts_with = "tracked")]
    runs: usize,
    /// Random seed of transmission paths, noise and operating points
    #[arg(long, default_value_t = EvaluationSettings::default().seed, conflicts_with = "tracked")]
    seed: u64,
    /// Number of records per run
    #[arg(long, default_value_t = EvaluationSettings::default().records, conflicts_with = "tracked")]
    records: usize,
    /// Number of simulated wear states that the runs of a case are drawn from
    #[arg(long, default_value_t = EvaluationSettings::default().states, conflicts_with = "tracked")]
    states: usize,
    /// Group of cases to run
    #[arg(long, value_enum, default_value_t = Cases::All, conflicts_with = "tracked")]
    cases: Cases,
    /// Run only cases whose name contains this text
    #[arg(long, value_name = "TEXT", conflicts_with = "tracked")]
    case: Option<String>,
    /// Number of varied gear pairs (ensemble members) to estimate with, up to 10240; 0 uses only the
    /// described pair
    #[arg(long, default_value_t = EnsembleSettings::default().members, value_parser = parse_members)]
    members: usize,
    /// Gear pair file (TOML) [default: the pair of Shen et al. 2022]
    #[arg(long, value_name = "FILE")]
    pair: Option<PathBuf>,
    /// Score recorded runs instead of simulated ones: folders of WAV files with a truth.csv
    ///
    /// Each WAV file is a record, in order of file names; truth.csv has a column wear_um with one row per
    /// file. A column file names the file of each row; without it, the rows are in the same order.
    /// `flankwatch simulate --out RUN.wav` writes such a folder. Channels are scored individually and
    /// together.
    #[arg(long, num_args = 1.., value_name = "FOLDER", group = "tracked")]
    recorded: Vec<PathBuf>,
    /// Score runs of this many ensemble members, each estimated with all other members
    #[arg(long, value_name = "MEMBERS", group = "tracked")]
    leave_one_out: Option<usize>,
    /// With --leave-one-out: number of records in which wear grows to 90 % of the library
    #[arg(long, value_name = "RECORDS", default_value_t = 120, requires = "leave_one_out")]
    wear_records: usize,
    /// With --leave-one-out: the machines stay healthy
    #[arg(long, requires = "leave_one_out")]
    healthy: bool,
    /// With --recorded or --leave-one-out: skip this many records in the middle of each run
    #[arg(long, value_name = "RECORDS", default_value_t = 0, requires = "tracked")]
    gap: usize,
    /// With --recorded or --leave-one-out: add an inspection half-way, with the true depth and this standard
    /// error in µm
    #[arg(long, value_name = "UM", requires = "tracked")]
    inspection_um: Option<f64>,
    /// With --recorded or --leave-one-out: score the forecasts of when wear passes this depth in µm
    #[arg(long, value_name = "UM", requires = "tracked")]
    limit_um: Option<f64>,
    /// With --recorded: score the estimates in this JSON file instead of the estimator's
    ///
    /// An object with a list for each run. The list has an element per record: [median, lower end, upper
    /// end of the 90 % interval] in µm, or null.
    #[arg(long, value_name = "FILE", requires = "recorded", conflicts_with_all = ["gap", "inspection_um", "limit_um"])]
    answers: Option<PathBuf>,
    /// With --recorded: print JSON
    #[arg(long, requires = "recorded")]
    json: bool,
    /// Write tables and plots to this self-contained HTML file
    #[arg(long, value_name = "FILE", conflicts_with = "tracked")]
    out: Option<PathBuf>,
    /// Data folder; libraries are cached in its folder `libraries`
    #[arg(long, value_name = "DIR", default_value = "flankwatch-data")]
    data_dir: PathBuf,
}

/// Runs the command.
pub(in crate::cli) fn run(args: &EvaluateArgs) -> Result<(), CliError> {
    for (option, value, least) in
        [("--runs", args.runs, 1), ("--records", args.records, 40), ("--states", args.states, 20)]
    {
        if value < least {
            return Err(CliError::argument(option, value, format!("at least {least}")));
        }
    }
    if let Some(error_um) = args.inspection_um.filter(|error_um| !(*error_um > 0.0 && *error_um <= 1e4)) {
        return Err(CliError::Argument(format!(
            "--inspection-um is {error_um}, expected a standard error above 0 and up to 10000 µm"
        )));
    }
    if let Some(limit_um) = args.limit_um.filter(|limit_um| !(*limit_um > 0.0 && *limit_um <= 1e4)) {
        return Err(CliError::Argument(format!(
            "--limit-um is {limit_um}, expected a depth above 0 and up to 10000 µm"
        )));
    }
    if let Some(out) = &args.out {
        check_apart("--out", out, args.pair.as_deref(), "the gear pair file")?;
        check_result(out, OutputKind::Page)?;
    }
    let pair = pair_file::read(args.pair.as_deref())?;
    let ensembles = Ensembles::new(&args.data_dir, args.members);
    let options = RunOptions { gap: args.gap, inspection_um: args.inspection_um, limit_um: args.limit_um };
    if let Some(count) = args.leave_one_out {
        check_left_out(count, args.members.div_ceil(VARIANTS), args)?;
        let ensemble = ensembles.of(&pair)?;
        // Pairs that the model refuses are not among its members.
        check_left_out(count, ensemble.groups(), args)?;
        let plan = LeftOutRun { records: args.wear_records, is_worn: !args.healthy };
        return recorded_runs::run_members(&ensemble, count, plan, options);
    }
    if !args.recorded.is_empty() {
        let ensemble = || ensembles.of(&pair);
        return recorded_runs::run(
            &args.recorded,
            &pair,
            &ensemble,
            options,
            args.answers.as_deref(),
            args.json,
        );
    }
    let settings =
        EvaluationSettings { runs: args.runs, records: args.records, states: args.states, seed: args.seed };
    let all = Case::all(&pair);
    let in_group = all.iter().filter(|case| args.cases.contains(case));
    let is_selected = |case: &&Case| args.case.as_ref().is_none_or(|text| case.name.contains(text));
    let cases: Vec<Case> = in_group.clone().filter(is_selected).cloned().collect();
    if cases.is_empty() {
        let names: Vec<&str> = in_group.map(|case| case.name.as_str()).collect();
        return Err(CliError::Argument(format!(
            "--case is {:?}, which matches no case, expected a part of one of: {}",
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
    output::print(&single_indicators(&scores))?;
    if let Some(path) = &args.out {
        output::write_file(path, page(&scores, &settings).as_bytes())?;
    }
    Ok(())
}

/// Checks the options of runs of members that are left out: at most one of each of `groups` but one.
fn check_left_out(count: usize, groups: usize, args: &EvaluateArgs) -> Result<(), CliError> {
    let members = args.members;
    if groups < 2 {
        let given = format!("{members} ({})", output::counted(groups as u64, "group"));
        let expected = format!("at least 2 groups of {VARIANTS} with --leave-one-out");
        return Err(CliError::argument("--members", given, expected));
    }
    let most = groups - 1;
    if !(1..=most).contains(&count) {
        let expected = format!("at least 1 and at most {most} with --members {members}");
        return Err(CliError::argument("--leave-one-out", count, expected));
    }
    if !(2..=MAX_LEFT_OUT_RECORDS).contains(&args.wear_records) {
        let expected = format!("2 to {MAX_LEFT_OUT_RECORDS}");
        return Err(CliError::argument("--wear-records", args.wear_records, expected));
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
    let has_estimates = score.estimates > 0;
    let number = |value: f64, digits: usize| {
        if has_estimates { format!("{value:.digits$}") } else { "-".to_owned() }
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

/// Formats the results of single indicators on the same runs.
fn single_indicators(scores: &[Score]) -> String {
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
    let worn: Vec<&Score> = scores.iter().filter(|score| score.rank_correlation.is_some()).collect();
    let ideal = json!({
        "type": "scatter", "mode": "lines", "x": [0, 1], "y": [0, 1], "name": "ideal",
        "line": { "color": "#000000", "width": 1 },
    });
    let actual = worn.iter().map(|score| {
        let (x, y) = (NOMINAL, &score.calibration);
        json!({ "type": "scatter", "mode": "lines+markers", "x": x, "y": y, "name": score.case })
    });
    let calibration: Vec<_> = iter::once(ideal).chain(actual).collect();
    let axis = |title: &str| json!({ "title": { "text": title }, "range": [0, 1] });
    let calibration = plot::html(
        &calibration,
        &json!({
            "title": { "text": "Calibration: coverage of central intervals" },
            "height": 560,
            "xaxis": axis("nominal coverage"),
            "yaxis": axis("actual coverage"),
        }),
    );
    let names: Vec<&str> = worn.iter().map(|score| score.case.as_str()).collect();
    let errors = ["median", "90 %", "99 %"].into_iter().enumerate().map(|(i, name)| {
        let values: Vec<f64> = worn.iter().map(|score| score.error_quantiles_um[i]).collect();
        json!({ "type": "scatter", "mode": "markers", "x": names, "y": values, "name": name })
    });
    let errors = plot::html(
        &errors.collect::<Vec<_>>(),
        &json!({
            "title": { "text": "Quantiles of the absolute error" },
            "height": 460,
            "yaxis": { "title": { "text": "µm" } },
        }),
    );
    let mut table = header();
    scores.iter().for_each(|score| table += &row(score));
    table += &single_indicators(scores);
    let script = plot::script_element();
    format!(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><title>flankwatch evaluation</title>{script}</head><body>\
         <h1>Wear estimation on simulated runs</h1><p>{} runs per case of {} records, seed {}. Errors and widths are of the maximum wear depth, in µm. \
         Covered: fraction of records whose 90 % interval contains the true depth. Flagged: fraction of fault-free records that were flagged. Found: \
         fraction of runs flagged within 10 records of a fault. Named: most frequent name of the fault's flagged records. Crossing: fraction of the \
         prognoses from half of life on whose 90 % interval contains the time of 80 % of the library's depth.</p><pre>{table}</pre>{}{}</body></html>",
        settings.runs, settings.records, settings.seed, calibration, errors,
    )
}
