//! Recorded runs with the truth beside them: what the estimator, or somebody else's answers, are worth on
//! them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;
use serde::Deserialize;

use super::{CliError, output};
use crate::evaluation::{
    Answer, HindsightScore, Observation, RecordedRun, RunScore, SingleIndicators, Trial, follow,
    leave_one_out, look_back, score_run, single_indicators,
};
use crate::gear::PairSpec;
use crate::library::Ensemble;
use crate::recording::{RecordDefaults, RecordingFile};
use crate::signal::{AnalysisSettings, Analyzer, MeshContext, OtherMeshes};

/// Records in the baseline.
const BASELINE: u32 = 20;

/// How far from nominal the speed may be.
const SPEED_TOLERANCE: f64 = 0.05;

#[derive(Deserialize)]
struct Truth {
    wear_um: f64,
}

/// Somebody else's answers: by run, one a record.
type Answers = BTreeMap<String, Vec<Option<[f64; 3]>>>;

/// Scores runs and prints a table, or JSON.
pub(super) fn run(
    folders: &[PathBuf],
    pair: &PairSpec,
    ensemble: &dyn Fn() -> Result<Arc<Ensemble>, CliError>,
    trial: Trial,
    answers: Option<&Path>,
    json: bool,
) -> Result<(), CliError> {
    let runs: Vec<RecordedRun> = folders.iter().map(|folder| read(folder, pair)).collect::<Result<_, _>>()?;
    let given: Option<Answers> = answers.map(read_answers).transpose()?;
    let mut scores = Vec::new();
    let followed: Vec<(Vec<Answer>, Option<HindsightScore>)> = match &given {
        Some(given) => {
            runs.iter().map(|run| Ok((foreign(run, given)?, None))).collect::<Result<_, CliError>>()?
        }
        None => {
            let ensemble = ensemble()?;
            let both = |run: &RecordedRun| {
                (follow(run, &ensemble, BASELINE, trial), look_back(run, &ensemble, BASELINE, trial))
            };
            runs.par_iter().map(both).collect()
        }
    };
    for ((answers, in_hindsight), run) in followed.iter().zip(&runs) {
        let inspected_at = trial.inspection_um.map(|_| run.records.len() / 2);
        let score = score_run(&run.name, answers, BASELINE as usize, inspected_at);
        scores.push(RunScore { in_hindsight: in_hindsight.clone(), ..score });
    }
    let single = single_indicators(&runs, BASELINE as usize);
    if json {
        let names = runs.iter().map(|run| run.name.clone());
        let answers: BTreeMap<_, _> = names.zip(followed.into_iter().map(|(answers, _)| answers)).collect();
        let all = serde_json::json!({ "scores": scores, "single_indicators": single, "answers": answers });
        output::print(&format!("{all}\n"))?;
        return Ok(());
    }
    output::print(&header())?;
    scores.iter().try_for_each(|score| output::print(&row(score)))?;
    for RunScore { run, in_hindsight, .. } in &scores {
        if let Some(HindsightScore { error_um, width_um, coverage }) = in_hindsight {
            output::print(&format!(
                "{run:<24} before the inspection, as told and looked back at: error {:.1} {:.1}, width {:.1} {:.1}, covered {:.3} {:.3}\n",
                error_um[0], error_um[1], width_um[0], width_um[1], coverage[0], coverage[1]
            ))?;
        }
    }
    output::print(&beside(&single))
}

/// Scores the estimate on runs of `count` members of an ensemble, each with the ensemble that lacks it.
pub(super) fn run_members(ensemble: &Ensemble, count: usize, trial: Trial) -> Result<(), CliError> {
    output::print(&header())?;
    let runs = leave_one_out(ensemble, count);
    let scores: Vec<RunScore> = runs
        .par_iter()
        .map(|(run, others)| {
            let inspected_at = trial.inspection_um.map(|_| run.records.len() / 2);
            score_run(&run.name, &follow(run, others, BASELINE, trial), BASELINE as usize, inspected_at)
        })
        .collect();
    scores.iter().try_for_each(|score| output::print(&row(score)))?;
    let all = scores.len().max(1) as f64;
    let mean = |of: fn(&RunScore) -> f64| scores.iter().map(of).sum::<f64>() / all;
    output::print(&format!(
        "{} members: covered {:.3}, error {:.1} µm, width {:.1} µm\n",
        scores.len(),
        mean(|score| score.coverage),
        mean(|score| score.mean_error_um),
        mean(|score| score.width_um),
    ))
}

/// What single indicators make of the same runs.
fn beside(scores: &[SingleIndicators]) -> String {
    let mut text = format!(
        "\n{:<24} {:>20} {:>26} {:>10}\n",
        "single indicators", "rms doubled, at µm", "regression on OMX, error", "its rank"
    );
    let or_dash = |value: Option<f64>, digits: usize| {
        value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
    };
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

fn header() -> String {
    format!(
        "{:<24} {:>9} {:>8} {:>8} {:>8} {:>7} {:>7} {:>7} {:>7} {:>8} {:>12}  {}\n",
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

fn row(score: &RunScore) -> String {
    let or_dash = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
    let after =
        score.error_after_um.zip(score.width_after_um).map(|(error, width)| format!("{error:.1} {width:.1}"));
    let last = score.last.map(|[median, low, high]| format!("{median:.0} [{low:.0}, {high:.0}]"));
    format!(
        "{:<24} {:>9} {:>8} {:>8.3} {:>8} {:>7} {:>7.1} {:>+7.1} {:>7.1} {:>8} {:>12}  {}\n",
        score.run,
        format!("{}/{}", score.estimated, score.records),
        score.flagged,
        score.coverage,
        score.longest_miss,
        or_dash(score.rank.map(|rank| format!("{rank:.3}"))),
        score.mean_error_um,
        score.bias_um,
        score.width_um,
        format!("{}/{}", score.narrow[1], score.narrow[0]),
        or_dash(after),
        or_dash(last),
    )
}

/// A folder's records in the order of their names, with the truth.
fn read(folder: &Path, pair: &PairSpec) -> Result<RecordedRun, CliError> {
    let failed = |what: String| CliError::Argument(format!("{}: {what}", folder.display()));
    let name = folder
        .file_name()
        .map_or_else(|| folder.display().to_string(), |name| name.to_string_lossy().into_owned());
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .map_err(|error| failed(error.to_string()))?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("wav")))
        .collect();
    files.sort();
    let mut table = csv::Reader::from_path(folder.join("truth.csv"))
        .map_err(|error| failed(format!("truth.csv: {error}")))?;
    let truth: Vec<f64> = table
        .deserialize()
        .map(|row| row.map(|Truth { wear_um }| wear_um))
        .collect::<Result<_, _>>()
        .map_err(|error| failed(format!("truth.csv: {error}, expected a column wear_um")))?;
    if files.len() != truth.len() {
        return Err(failed(format!(
            "{} WAV files and {} lines of truth.csv, expected as many",
            files.len(),
            truth.len()
        )));
    }
    let records: Vec<Observation> = files
        .par_iter()
        .zip(truth)
        .map_init(
            || Analyzer::new(AnalysisSettings::default()),
            |analyzer, (path, wear_um)| analyse(analyzer, path, wear_um, pair),
        )
        .collect::<Result<_, _>>()?;
    Ok(RecordedRun { name, records })
}

/// A file's first record.
fn analyse(
    analyzer: &mut Analyzer,
    path: &Path,
    wear_um: f64,
    pair: &PairSpec,
) -> Result<Observation, CliError> {
    let failed = |what: String| CliError::Argument(format!("{}: {what}", path.display()));
    let mut file = RecordingFile::open(path, RecordDefaults::default(), None)
        .map_err(|error| failed(error.to_string()))?;
    let recorded =
        file.next().ok_or_else(|| failed("no record".into()))?.map_err(|error| failed(error.to_string()))?;
    let mesh = MeshContext {
        teeth: pair.geometry.teeth[0],
        mate_teeth: pair.geometry.teeth[1],
        nominal_shaft_speed_hz: pair.operation.shaft_speed_hz,
        tolerance: SPEED_TOLERANCE,
        nominal_is_exact: false,
        others: OtherMeshes::NONE,
    };
    let analysis = analyzer.analyze(&recorded.record, &mesh);
    Ok(Observation {
        wear_um,
        single: ["rms", "kurtosis", "omx"].map(|name| analysis.indicators.get(name).unwrap_or(0.0)),
        features: analysis.features,
    })
}

fn read_answers(path: &Path) -> Result<Answers, CliError> {
    let failed = |what: String| CliError::Argument(format!("{}: {what}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|error| failed(error.to_string()))?;
    serde_json::from_str(&text)
        .map_err(|error| failed(format!("{error}, expected lists of [median, p05, p95] or null by run")))
}

/// Somebody else's answers to a run.
fn foreign(run: &RecordedRun, given: &Answers) -> Result<Vec<Answer>, CliError> {
    let answers = given.get(&run.name).filter(|answers| answers.len() == run.records.len());
    let answers = answers.ok_or_else(|| {
        let expected = run.records.len();
        CliError::Argument(format!("--answers has no list of {expected} answers for the run {:?}", run.name))
    })?;
    let answer = |(record, (wear_um, observation)): (usize, (&Option<[f64; 3]>, &Observation))| Answer {
        record,
        truth_um: observation.wear_um,
        wear_um: *wear_um,
        flagged: false,
        reason: String::new(),
    };
    Ok(answers.iter().zip(&run.records).enumerate().map(answer).collect())
}
