//! Scores of the estimator, or of another estimator's answers, on recorded runs with known wear.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;
use serde::Deserialize;

use super::score_table::{forecast_table, header, indicator_table, means, row};
use super::simulate::TRUTH_FILE_NAME;
use crate::cli::{CliError, output};
use crate::evaluation::{
    HindsightScore, LeftOutRun, Observation, RecordEstimate, RecordedRun, RunOptions, RunScore,
    estimate_channels, estimate_run, leave_one_out, look_back, score_run, single_indicators,
};
use crate::gear::PairSpec;
use crate::library::Ensemble;
use crate::recording::{RecordDefaults, RecordingFile};
use crate::signal::{AnalysisSettings, Analyzer, MeshContext};

/// Number of records in the baseline.
const BASELINE: u32 = 20;

/// Greatest relative deviation of the speed from nominal.
const SPEED_TOLERANCE: f64 = 0.05;

/// A row of truth.csv.
#[derive(Deserialize)]
struct Truth {
    /// Name of its WAV file, if the table has this column.
    file: Option<String>,
    wear_um: f64,
}

/// Another estimator's answers by run, one per record: median and ends of the 90 % interval in µm.
type Answers = BTreeMap<String, Vec<Option<[f64; 3]>>>;

/// The estimates of a run, or of all its channels together.
struct EstimatedRun {
    name: String,
    answers: Vec<RecordEstimate>,
    in_hindsight: Option<HindsightScore>,
}

/// Scores runs and prints a table or JSON. Channels are scored individually and together.
pub(super) fn run(
    folders: &[PathBuf],
    pair: &PairSpec,
    ensemble: &dyn Fn() -> Result<Arc<Ensemble>, CliError>,
    trial: RunOptions,
    answers: Option<&Path>,
    json: bool,
) -> Result<(), CliError> {
    let names = names_of(folders);
    let machines: Vec<Vec<RecordedRun>> = folders
        .iter()
        .zip(&names)
        .map(|(folder, name)| read(folder, name, pair))
        .collect::<Result<_, _>>()?;
    let runs: Vec<&RecordedRun> = machines.iter().flatten().collect();
    let imported: Option<Answers> = answers.map(read_answers).transpose()?;
    let mut estimated: Vec<EstimatedRun> = Vec::new();
    match &imported {
        Some(imported) => {
            for run in &runs {
                let (name, answers) = (run.name.clone(), imported_answers(run, imported)?);
                estimated.push(EstimatedRun { name, answers, in_hindsight: None });
            }
        }
        None => {
            let ensemble = ensemble()?;
            let machine = |(channels, name): (&Vec<RecordedRun>, &String)| {
                let (of_channels, together) = estimate_channels(channels, &ensemble, BASELINE, trial);
                let mut estimated: Vec<EstimatedRun> = channels
                    .iter()
                    .zip(of_channels)
                    .map(|(run, answers)| EstimatedRun {
                        name: run.name.clone(),
                        answers,
                        in_hindsight: look_back(run, &ensemble, BASELINE, trial),
                    })
                    .collect();
                if channels.len() > 1 {
                    let name = format!("{name}, together");
                    estimated.push(EstimatedRun { name, answers: together, in_hindsight: None });
                }
                estimated
            };
            estimated = machines.par_iter().zip(&names).flat_map_iter(machine).collect();
        }
    }
    let score = |EstimatedRun { name, answers, in_hindsight }: &EstimatedRun| {
        let score = score_run(name, answers, BASELINE as usize, trial);
        RunScore { in_hindsight: in_hindsight.clone(), ..score }
    };
    let scores: Vec<RunScore> = estimated.iter().map(score).collect();
    let single = single_indicators(&runs, BASELINE as usize);
    if json {
        let answers: BTreeMap<_, _> = estimated.into_iter().map(|run| (run.name, run.answers)).collect();
        let all = serde_json::json!({ "scores": scores, "single_indicators": single, "answers": answers });
        output::print(&format!("{all}\n"))?;
        return Ok(());
    }
    output::print(&header())?;
    scores.iter().try_for_each(|score| output::print(&row(score)))?;
    for RunScore { run, in_hindsight, .. } in &scores {
        if let Some(HindsightScore { error_um, width_um, coverage }) = in_hindsight {
            output::print(&format!(
                "{run:<24} before the inspection, filtered and smoothed: error {:.1} {:.1}, width {:.1} {:.1}, covered {:.3} {:.3}\n",
                error_um[0], error_um[1], width_um[0], width_um[1], coverage[0], coverage[1]
            ))?;
        }
    }
    output::print(&forecast_table(&scores))?;
    output::print(&indicator_table(&single))
}

/// Scores the estimate on runs of `count` ensemble members, each estimated without the member itself.
pub(super) fn run_members(
    ensemble: &Ensemble,
    count: usize,
    plan: LeftOutRun,
    options: RunOptions,
) -> Result<(), CliError> {
    output::print(&header())?;
    let runs = leave_one_out(ensemble, count, plan);
    let scores: Vec<RunScore> = runs
        .par_iter()
        .map(|(run, others)| {
            let answers = estimate_run(run, others, BASELINE, options);
            score_run(&run.name, &answers, BASELINE as usize, options)
        })
        .collect();
    scores.iter().try_for_each(|score| output::print(&row(score)))?;
    output::print(&forecast_table(&scores))?;
    let members = output::counted(scores.len() as u64, "member");
    let of_run = |score: &RunScore| Some([score.coverage?, score.mean_error_um?, score.width_um?]);
    output::print(&means(&members, scores.iter().filter_map(of_run).collect()))?;
    if options.inspection_um.is_some() {
        let after = scores.iter().filter_map(|score| score.after.as_ref());
        let after = after.map(|after| [after.coverage, after.mean_error_um, after.width_um]);
        output::print(&means("from the inspection on", after.collect()))?;
    }
    Ok(())
}

/// Returns the names of the folders; those that several share are replaced by their paths.
fn names_of(folders: &[PathBuf]) -> Vec<String> {
    let is_shared =
        |name: &OsStr| folders.iter().filter(|folder| folder.file_name() == Some(name)).count() > 1;
    let name = |folder: &PathBuf| match folder.file_name() {
        Some(name) if !is_shared(name) => name.to_string_lossy().into_owned(),
        _ => folder.display().to_string(),
    };
    folders.iter().map(name).collect()
}

/// Reads a folder's records, in order of file names, with their true wear; returns a run for each channel.
fn read(folder: &Path, name: &str, pair: &PairSpec) -> Result<Vec<RecordedRun>, CliError> {
    let failed = |what: String| CliError::Argument(format!("{}: {what}", folder.display()));
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .map_err(|error| failed(error.to_string()))?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("wav")))
        .collect();
    files.sort();
    let depths_um = read_truth(folder, &files).map_err(|error| failed(format!("truth.csv: {error}")))?;
    if files.len() <= BASELINE as usize {
        let records = output::counted(files.len() as u64, "record");
        return Err(failed(format!(
            "{records}, all within the baseline of {BASELINE}, expected more than {BASELINE}"
        )));
    }
    let records: Vec<Vec<Observation>> = files
        .par_iter()
        .zip(depths_um)
        .map_init(
            || Analyzer::new(AnalysisSettings::default()),
            |analyzer, (path, wear_um)| analyse(analyzer, path, wear_um, pair),
        )
        .collect::<Result<_, _>>()?;
    let count = records.first().map_or(0, Vec::len);
    let mut channels = vec![Vec::with_capacity(records.len()); count];
    for (path, record) in files.iter().zip(records) {
        if record.len() != count {
            let (file, has) = (path.display(), record.len());
            return Err(failed(format!("{file} has {has} channels, expected {count} as in the first file")));
        }
        channels.iter_mut().zip(record).for_each(|(channel, observation)| channel.push(observation));
    }
    let name = |channel: usize| match count {
        1 => name.to_owned(),
        _ => format!("{name}, channel {}", channel + 1),
    };
    let channels = channels.into_iter().enumerate();
    Ok(channels.map(|(channel, records)| RecordedRun { name: name(channel), records }).collect())
}

/// Reads the true depth of each file from truth.csv, whose rows name their files or are in the same order.
fn read_truth(folder: &Path, files: &[PathBuf]) -> Result<Vec<f64>, String> {
    let mut table =
        csv::Reader::from_path(folder.join(TRUTH_FILE_NAME)).map_err(|error| error.to_string())?;
    let rows: Vec<Truth> = table
        .deserialize()
        .collect::<Result<_, _>>()
        .map_err(|error| format!("{error}, expected a column wear_um"))?;
    let names_files = rows.iter().any(|row| row.file.is_some());
    let mut by_file = BTreeMap::new();
    for (row, Truth { file, wear_um }) in (1..).zip(&rows) {
        if !(*wear_um >= 0.0 && wear_um.is_finite()) {
            return Err(format!("wear_um of row {row} is {wear_um}, expected a depth from 0 µm"));
        }
        let file = file.as_deref().unwrap_or_default();
        let path = folder.join(file);
        if names_files && (files.binary_search(&path).is_err() || by_file.insert(path, *wear_um).is_some()) {
            return Err(format!(
                "file of row {row} is {file:?}, expected a WAV file of the folder, each once"
            ));
        }
    }
    if files.len() != rows.len() {
        return Err(format!("{} rows and {} WAV files, expected equal numbers", rows.len(), files.len()));
    }
    Ok(if names_files {
        by_file.into_values().collect()
    } else {
        rows.iter().map(|row| row.wear_um).collect()
    })
}

/// Analyses the first record of each channel of a file.
fn analyse(
    analyzer: &mut Analyzer,
    path: &Path,
    wear_um: f64,
    pair: &PairSpec,
) -> Result<Vec<Observation>, CliError> {
    let failed = |what: String| CliError::Argument(format!("{}: {what}", path.display()));
    let file = RecordingFile::open(path, RecordDefaults::default(), None)
        .map_err(|error| failed(error.to_string()))?;
    let mesh = MeshContext::new(pair.geometry.teeth, pair.operation.shaft_speed_hz, SPEED_TOLERANCE);
    let (mut observations, mut start) = (Vec::new(), None);
    for recorded in file {
        let record = recorded.map_err(|error| failed(error.to_string()))?.record;
        // A long file has several records per channel: only the first one is used.
        if *start.get_or_insert(record.start_time()) != record.start_time() {
            break;
        }
        let analysis = analyzer.analyze(&record, &mesh);
        observations.push(Observation {
            wear_um,
            single: ["rms", "kurtosis", "omx"].map(|name| analysis.indicators.get(name).unwrap_or(0.0)),
            features: analysis.features,
        });
    }
    if observations.is_empty() {
        return Err(failed("no record".into()));
    }
    Ok(observations)
}

fn read_answers(path: &Path) -> Result<Answers, CliError> {
    let failed = |what: String| CliError::Argument(format!("{}: {what}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|error| failed(error.to_string()))?;
    serde_json::from_str(&text).map_err(|error| {
        failed(format!("{error}, expected a list of [median, low, high] or null for each run"))
    })
}

/// Pairs another estimator's answers with the records of a run.
fn imported_answers(run: &RecordedRun, imported: &Answers) -> Result<Vec<RecordEstimate>, CliError> {
    let answers = imported.get(&run.name).filter(|answers| answers.len() == run.records.len());
    let answers = answers.ok_or_else(|| {
        let expected = run.records.len();
        CliError::Argument(format!("--answers has no list of {expected} answers for the run {:?}", run.name))
    })?;
    let is_out_of_order = |[median, low, high]: [f64; 3]| !(low <= median && median <= high);
    if let Some(record) = answers.iter().position(|answer| answer.is_some_and(is_out_of_order)) {
        return Err(CliError::Argument(format!(
            "--answers has {:?} for record {} of the run {:?}, expected the median within its interval",
            answers[record].unwrap_or_default(),
            record + 1,
            run.name
        )));
    }
    let answer =
        |(record, (wear_um, observation)): (usize, (&Option<[f64; 3]>, &Observation))| RecordEstimate {
            record,
            truth_um: observation.wear_um,
            wear_um: *wear_um,
            forecast: None,
            flagged: false,
            sensor_fault: None,
            suspected_fault: None,
            reason: String::new(),
        };
    Ok(answers.iter().zip(&run.records).enumerate().map(answer).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_with_the_same_name_are_told_apart_by_their_paths() {
        let folders = ["threshold/1101", "loaded/1101", "healthy/1104"].map(PathBuf::from);
        assert_eq!(names_of(&folders), ["threshold/1101", "loaded/1101", "1104"]);
        assert_eq!(names_of(&[PathBuf::from(".")]), ["."]);
    }

    #[test]
    fn a_run_within_the_baseline_and_a_true_depth_that_is_no_number_are_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let pair = crate::cli::simulation::pair_file::read(None).unwrap();
        std::fs::write(folder.path().join("truth.csv"), "wear_um\n").unwrap();
        let error = read(folder.path(), "run", &pair).unwrap_err().to_string();
        assert!(error.contains("0 records, all within the baseline of 20"), "{error}");
        for wrong in ["NaN", "inf", "-1"] {
            std::fs::write(folder.path().join("truth.csv"), format!("wear_um\n0\n{wrong}\n")).unwrap();
            let error = read(folder.path(), "run", &pair).unwrap_err().to_string();
            assert!(error.contains(&format!("wear_um of row 2 is {wrong}")), "{error}");
        }
    }

    #[test]
    fn runs_without_estimates_are_left_out_of_the_means_and_show_dashes() {
        let text = means("2 members", vec![[0.5, 4.0, 20.0], [1.0, 2.0, 10.0]]);
        assert_eq!(text, "2 members: covered 0.750, error 3.0 µm, width 15.0 µm\n");
        assert_eq!(means("1 member", Vec::new()), "1 member: covered -, error - µm, width - µm\n");
        let score = row(&score_run("a", &[], BASELINE as usize, RunOptions::default()));
        let cells: Vec<&str> = score.split_whitespace().collect();
        assert_eq!(cells, ["a", "0/0", "0", "-", "0", "-", "-", "-", "-", "0/0", "-", "-"]);
    }

    #[test]
    fn the_rows_of_the_truth_are_found_by_their_file() {
        let folder = tempfile::tempdir().unwrap();
        let files = ["a.wav", "b.wav", "c.wav"].map(|name| folder.path().join(name));
        let read = |table: &str| {
            std::fs::write(folder.path().join("truth.csv"), table).unwrap();
            read_truth(folder.path(), &files)
        };
        assert_eq!(read("wear_um,file\n2,c.wav\n0,a.wav\n1,b.wav\n").unwrap(), [0.0, 1.0, 2.0]);
        assert_eq!(read("record,wear_um\n0,2\n1,0\n2,1\n").unwrap(), [2.0, 0.0, 1.0]);
        for wrong in ["none.wav", "a.wav", ""] {
            let error = read(&format!("file,wear_um\na.wav,0\n{wrong},1\nc.wav,2\n")).unwrap_err();
            assert!(error.contains(&format!("file of row 2 is {wrong:?}")), "{error}");
        }
        let error = read("file,wear_um\na.wav,0\nc.wav,2\n").unwrap_err();
        assert!(error.contains("2 rows and 3 WAV files"), "{error}");
    }

    #[test]
    fn an_interval_without_its_median_is_rejected() {
        let observation =
            Observation { wear_um: 1.0, features: crate::signal::Features::default(), single: [0.0; 3] };
        let run = RecordedRun { name: "a".to_owned(), records: vec![observation; 2] };
        let imported = |second: [f64; 3]| Answers::from([("a".to_owned(), vec![None, Some(second)])]);
        assert!(imported_answers(&run, &imported([5.0, 1.0, 9.0])).is_ok());
        let error = imported_answers(&run, &imported([1.0, 5.0, 9.0])).unwrap_err().to_string();
        assert!(error.contains("[1.0, 5.0, 9.0] for record 2 of the run \"a\""), "{error}");
    }
}
