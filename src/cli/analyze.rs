//! `flankwatch analyze`: indicators and wear of recordings, without a server.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::{Args, ValueEnum};
use jiff::{SignedDuration, Timestamp};
use serde::Serialize;

use super::library::kept_ensemble;
use super::{CliError, output};
use crate::asset::AssetSpec;
use crate::estimate::{ChannelEstimator, ChannelState, EstimatorSettings, PanelChange, WearEstimate};
use crate::library::EnsembleSettings;
use crate::recording::{Cut, RecordDefaults, Recorded, RecordingFile};
use crate::report::{Report, ReportedAlarm, ReportedRecord, angle_words};
use crate::signal::{
    AnalysisSettings, Analyzer, BandError, BandSource, Basis, Condition, ConditionSettings, EnvelopeBand, EnvelopeSearch, Features,
    Indicators, MeshContext, OperatingPoint, Record, ShaftSpeed, Spectrum, SpeedSource,
};

/// Arguments of `flankwatch analyze`.
#[derive(Args)]
pub(super) struct AnalyzeArgs {
    /// WAV or MCAP recordings, in time order
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// The machine: tooth numbers, nominal speed, gear pair. Without it, indicators that need no speed
    #[arg(long)]
    asset: Option<PathBuf>,
    /// How to print
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
    /// Write a report for a browser or a printer
    #[arg(long)]
    report: Option<PathBuf>,
    /// Cut recordings into records of this length
    #[arg(long)]
    record_seconds: Option<f64>,
    /// Time of the first sample of the first recording that does not say; later ones follow on it
    #[arg(long, default_value = "1970-01-01T00:00:00Z")]
    start_time: Timestamp,
    /// Rotational frequency of the driving shaft in hertz, where the recording does not say
    #[arg(long)]
    shaft_speed_hz: Option<f64>,
    /// Torque on the driving shaft in N·m, where the recording does not say
    #[arg(long)]
    torque_nm: Option<f64>,
    /// Envelope spectrum of each record, in JSON, in the asset's band (asset), around the strongest mesh harmonic (mesh), in the
    /// band that the fast kurtogram finds (kurtogram), or from LOW to HIGH hertz
    #[arg(long, value_name = "asset|mesh|kurtogram|LOW,HIGH")]
    envelope: Option<EnvelopeArg>,
    /// Folder of the service's data; libraries are kept in its `libraries`
    #[arg(long, default_value = "flankwatch-data")]
    data_dir: PathBuf,
    /// Pairs like the described one that the estimate is made with; 0 for the described pair alone
    #[arg(long, default_value_t = EnsembleSettings::default().members)]
    members: usize,
}

/// How results are printed.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Aligned columns for people
    Table,
    /// One array, an object a record
    Json,
    /// A line a record
    Csv,
}

/// Which band's envelope is wanted.
#[derive(Clone, Copy, Debug, PartialEq)]
enum EnvelopeArg {
    Asset,
    Search(EnvelopeSearch),
    Hertz([f64; 2]),
}

impl FromStr for EnvelopeArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "asset" => return Ok(Self::Asset),
            "mesh" => return Ok(Self::Search(EnvelopeSearch::MeshHarmonic)),
            "kurtogram" => return Ok(Self::Search(EnvelopeSearch::Kurtogram)),
            _ => {}
        }
        let band = text
            .split_once(',')
            .and_then(|(low, high)| Some([low.trim().parse().ok()?, high.trim().parse().ok()?]));
        match band {
            Some([low, high]) if low >= 0.0 && low < high && f64::is_finite(high) => Ok(Self::Hertz([low, high])),
            _ => Err("expected asset, mesh, kurtogram, or two frequencies in hertz as in 2000,4000".to_owned()),
        }
    }
}

/// Highest lines of an envelope spectrum that are printed.
const ENVELOPE_LINES: usize = 8;

/// The envelope spectrum of a record in short.
#[derive(Debug, Serialize)]
pub(super) struct AnalyzedEnvelope {
    #[serde(flatten)]
    pub(super) band: EnvelopeBand,
    /// Its highest lines, the highest first.
    pub(super) lines: Vec<EnvelopeLine>,
    /// Why there is no spectrum of this band.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) absent: Option<String>,
}

/// One line of an envelope spectrum.
#[derive(Debug, Serialize)]
pub(super) struct EnvelopeLine {
    pub(super) frequency_hz: f64,
    pub(super) amplitude: f64,
}

impl AnalyzedEnvelope {
    fn new(band: EnvelopeBand, spectrum: &Result<Spectrum, BandError>) -> Self {
        let lines = spectrum.as_ref().map_or_else(
            |_| Vec::new(),
            |spectrum| {
                let amplitude = &spectrum.amplitude;
                // The first two bins hold what is left of the mean under the window.
                let mut peaks: Vec<usize> = (2..amplitude.len().saturating_sub(1))
                    .filter(|&bin| amplitude[bin] > amplitude[bin - 1] && amplitude[bin] >= amplitude[bin + 1])
                    .collect();
                peaks.sort_by(|&a, &b| amplitude[b].total_cmp(&amplitude[a]));
                peaks.truncate(ENVELOPE_LINES);
                let line = |bin: usize| EnvelopeLine {
                    frequency_hz: spectrum.frequency_hz(bin),
                    amplitude: amplitude[bin],
                };
                peaks.into_iter().map(line).collect()
            },
        );
        Self {
            band,
            lines,
            absent: spectrum.as_ref().err().map(ToString::to_string),
        }
    }
}

/// One analysed record, as it is printed.
#[derive(Debug, Serialize)]
pub(super) struct AnalyzedRecord {
    pub(super) file: String,
    pub(super) channel: String,
    pub(super) start_time: Timestamp,
    pub(super) sample_rate_hz: f64,
    pub(super) samples: usize,
    pub(super) unit: String,
    pub(super) shaft_speed_hz: Option<f64>,
    pub(super) shaft_speed_source: Option<SpeedSource>,
    pub(super) mesh_frequency_hz: Option<f64>,
    #[serde(flatten)]
    pub(super) basis: Basis,
    #[serde(flatten)]
    pub(super) indicators: Indicators,
    /// The envelope spectrum where it was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) envelope: Option<AnalyzedEnvelope>,
    /// The wear estimate; null where there is none.
    pub(super) wear: Option<WearEstimate>,
    /// The estimate in words, or why there is none.
    pub(super) wear_reason: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) reference_wear_um: Option<f64>,
    #[serde(skip)]
    features: Features,
}

impl From<&AnalyzedRecord> for ReportedRecord {
    fn from(record: &AnalyzedRecord) -> Self {
        Self {
            name: record.file.clone(),
            channel: record.channel.clone(),
            start_time: record.start_time,
            unit: record.unit.clone(),
            shaft_speed_hz: record.shaft_speed_hz,
            indicators: record.indicators.clone(),
            shaft_angle: record.basis.shaft_angle.clone(),
            wear: record.wear.clone(),
            wear_words: record.wear_reason.clone(),
            reference_wear_um: record.reference_wear_um,
        }
    }
}

/// Runs the command.
pub(super) fn run(args: &AnalyzeArgs) -> Result<(), CliError> {
    let asset = args.asset.as_deref().map(read_asset).transpose()?;
    let mut analysis = Analysis {
        args,
        asset,
        analyzer: Analyzer::new(AnalysisSettings::default()),
        records: Vec::new(),
        last_spectrum: None,
        alarms: Vec::new(),
    };
    let mut next_start = args.start_time;
    let mut failed = 0;
    for path in &args.files {
        if let Err(error) = analysis.take_file(path, &mut next_start) {
            eprintln!("error: {error}");
            failed += 1;
        }
    }
    analysis.estimate_wear()?;
    output::print(&match args.format {
        Format::Table => table(&analysis.records),
        Format::Json => serde_json::to_string_pretty(&analysis.records).expect("records hold finite numbers and strings") + "\n",
        Format::Csv => csv(&analysis.records),
    })?;
    if let Some(path) = &args.report {
        output::write_file(path, analysis.report().html().as_bytes())?;
    }
    if failed > 0 {
        return Err(CliError::SomeFailed {
            failed,
            all: args.files.len(),
        });
    }
    Ok(())
}

pub(super) fn read_asset(path: &Path) -> Result<AssetSpec, CliError> {
    let text = fs::read_to_string(path).map_err(CliError::io(path))?;
    AssetSpec::from_toml(&text).map_err(|source| CliError::Asset {
        path: path.to_owned(),
        source,
    })
}

struct Analysis<'a> {
    args: &'a AnalyzeArgs,
    asset: Option<AssetSpec>,
    analyzer: Analyzer,
    records: Vec<AnalyzedRecord>,
    last_spectrum: Option<Spectrum>,
    alarms: Vec<ReportedAlarm>,
}

impl Analysis<'_> {
    fn report(&self) -> Report {
        Report {
            asset: self.asset.as_ref().map(|asset| asset.name_or_id().to_string()),
            limits: self.asset.as_ref().map(|asset| asset.limits).unwrap_or_default(),
            records: self.records.iter().map(ReportedRecord::from).collect(),
            last_spectrum: self.last_spectrum.clone(),
            alarms: self.alarms.clone(),
            ..Report::default()
        }
    }

    fn take_file(&mut self, path: &Path, next_start: &mut Timestamp) -> Result<(), CliError> {
        let defaults = RecordDefaults {
            start_time: *next_start,
            unit: self.asset.as_ref().and_then(|asset| asset.sensor.unit.clone()),
            channel_units: self.asset.as_ref().map(AssetSpec::channel_units).unwrap_or_default(),
            operating_point: OperatingPoint {
                shaft_speed_hz: self.args.shaft_speed_hz,
                torque_nm: self.args.torque_nm,
                ..OperatingPoint::default()
            },
            ..RecordDefaults::default()
        };
        let cut = self.args.record_seconds.map(Cut::Seconds);
        let mut file = RecordingFile::open(path, defaults, cut).map_err(CliError::recording(path))?;
        if let Some(seconds) = file.default_cut_seconds() {
            eprintln!(
                "note: {}: a long recording, cut into records of {seconds} s; --record-seconds chooses another length",
                path.display()
            );
        }
        for recorded in &mut file {
            let recorded = recorded.map_err(CliError::recording(path))?;
            let length = SignedDuration::from_secs_f64(recorded.record.duration_s());
            *next_start = (*next_start).max(recorded.record.start_time() + length);
            self.take_record(path, recorded);
        }
        Ok(())
    }

    fn take_record(&mut self, path: &Path, recorded: Recorded) {
        let record = recorded.record;
        // Without a description there is no mesh to speak of, and no reason to name what it would have given.
        let unknown = ConditionSettings {
            mesh: MeshContext::unknown(),
            bands: &[],
            gear_indicators: false,
        };
        let settings = self.asset.as_ref().map_or(unknown, AssetSpec::condition_settings);
        let seen = self
            .asset
            .as_ref()
            .map_or(Cow::Borrowed(&record), |asset| asset.seen_from_shaft(&record));
        let Condition { analysis, basis } = self.analyzer.condition(&seen, &settings);
        let envelope = self
            .args
            .envelope
            .map(|asked| self.envelope(&record, analysis.shaft_speed.as_ref(), asked));
        if self.args.report.is_some() {
            self.last_spectrum = Some(self.analyzer.amplitude_spectrum(&record));
        }
        self.records.push(AnalyzedRecord {
            file: path.display().to_string(),
            channel: record.channel().to_owned(),
            start_time: record.start_time(),
            sample_rate_hz: record.sample_rate_hz(),
            samples: record.samples().len(),
            unit: record.unit().to_owned(),
            shaft_speed_hz: analysis.shaft_speed.map(|speed| speed.shaft_speed_hz),
            shaft_speed_source: analysis.shaft_speed.map(|speed| speed.source),
            mesh_frequency_hz: analysis.shaft_speed.map(|speed| speed.mesh_frequency_hz).filter(|&hz| hz > 0.0),
            basis,
            indicators: analysis.indicators,
            envelope,
            wear: None,
            wear_reason: "no asset is described, see --asset".to_owned(),
            reference_wear_um: recorded.reference_wear_um,
            features: analysis.features,
        });
    }

    fn envelope(&mut self, record: &Record, speed: Option<&ShaftSpeed>, asked: EnvelopeArg) -> AnalyzedEnvelope {
        let asset = self.asset.as_ref();
        let search = match asked {
            EnvelopeArg::Search(search) => search,
            _ => asset.map_or_else(EnvelopeSearch::default, |asset| asset.envelope_band),
        };
        let given = match asked {
            EnvelopeArg::Hertz(band_hz) => Some(EnvelopeBand::given(band_hz, BandSource::Query)),
            EnvelopeArg::Asset => asset.and_then(AssetSpec::given_envelope_band),
            EnvelopeArg::Search(_) => None,
        };
        let band = given.unwrap_or_else(|| self.analyzer.envelope_band(record, speed, search));
        let spectrum = self.analyzer.envelope_spectrum(record, band.band_hz);
        AnalyzedEnvelope::new(band, &spectrum)
    }

    /// Folds each channel's records in time order, as the service does.
    fn estimate_wear(&mut self) -> Result<(), CliError> {
        let Some(asset) = &self.asset else { return Ok(()) };
        let settings = EstimatorSettings {
            baseline_records: asset.baseline.records,
            limit_um: asset.limits.danger_um.or(asset.limits.warning_um),
        };
        let longest = self
            .records
            .iter()
            .fold(BTreeMap::new(), |mut counts: BTreeMap<&str, u32>, record| {
                *counts.entry(&record.channel).or_default() += 1;
                counts
            });
        // A library is worth its simulation only if some channel gets past its baseline.
        let needed = longest.values().any(|&count| count > settings.baseline_records);
        let pair = asset.gear.pair.as_ref().filter(|_| needed);
        let ensemble = pair
            .map(|pair| kept_ensemble(&self.args.data_dir, pair, self.args.members))
            .transpose()?;
        let estimator = ChannelEstimator::new(settings, ensemble, asset.alarm_rules());
        let mut order: Vec<usize> = (0..self.records.len()).collect();
        order.sort_by_key(|&i| self.records[i].start_time);
        let mut channels: BTreeMap<String, (ChannelState, Vec<PanelChange>)> = BTreeMap::new();
        for index in order {
            let record = &mut self.records[index];
            let channel = channels.entry(record.channel.clone());
            let (state, changes) = channel.or_insert_with(|| (estimator.start(), Vec::new()));
            let result = estimator.record(state, record.start_time, &record.features, &record.indicators);
            record.indicators.extend(result.indicators);
            changes.extend(result.changes);
            record.wear_reason = result.wear.reason.clone();
            record.wear = result.wear.median_um.is_some().then_some(result.wear);
        }
        let rules = estimator.rules();
        let reported = channels
            .iter()
            .flat_map(|(channel, (_, changes))| ReportedAlarm::of_changes(channel, rules, changes));
        self.alarms = reported.collect();
        Ok(())
    }
}

/// Indicators in the table's columns, and the first ones of the CSV's.
const COLUMNS: [&str; 5] = ["rms", "kurtosis", "crest_factor", "omx", "mesh_2"];

/// Indicators over the shaft's angle in the table's columns, where some record has them.
const GEAR_COLUMNS: [&str; 5] = ["omx_tracked", "fm0", "fm4", "na4", "sideband_level_factor"];

fn table(records: &[AnalyzedRecord]) -> String {
    let gear = records.iter().any(|record| record.basis.shaft_angle.is_some());
    let columns: Vec<&str> = COLUMNS.iter().chain(GEAR_COLUMNS.iter().filter(|_| gear)).copied().collect();
    let mut text = format!("{:<28} {:<12} {:<30} {:>9}", "file", "channel", "start_time", "shaft_hz");
    for name in &columns {
        text += &format!(" {:>12}", name.replace("sideband_level_factor", "slf"));
    }
    if gear {
        text += &format!("  {:<24}", "angle");
    }
    text += "  wear\n";
    for record in records {
        let speed = record.shaft_speed_hz.map_or_else(|| "-".to_owned(), |hz| format!("{hz:.3}"));
        text += &format!("{:<28} {:<12} {:<30} {speed:>9}", record.file, record.channel, record.start_time);
        for name in &columns {
            let value = record.indicators.get(name);
            text += &format!(" {:>12}", value.map_or_else(|| "-".to_owned(), |value| format!("{value:.5}")));
        }
        if gear {
            text += &format!(
                "  {:<24}",
                record.basis.shaft_angle.as_ref().map_or_else(|| "-".to_owned(), angle_words)
            );
        }
        text += &format!("  {}\n", record.wear_reason);
    }
    text
}

fn csv(records: &[AnalyzedRecord]) -> String {
    let number = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
    let mut writer = csv::Writer::from_writer(Vec::new());
    let known: BTreeSet<&String> = records.iter().flat_map(|record| record.indicators.values.keys()).collect();
    let others: Vec<&str> = known
        .into_iter()
        .map(String::as_str)
        .filter(|name| !COLUMNS.contains(name))
        .collect();
    let mut header: Vec<&str> = vec![
        "file",
        "channel",
        "start_time",
        "sample_rate_hz",
        "samples",
        "unit",
        "shaft_speed_hz",
        "mesh_frequency_hz",
    ];
    header.extend(COLUMNS);
    header.extend(["wear_median_um", "wear_p05_um", "wear_p95_um", "wear_reason", "shaft_angle"]);
    header.extend(&others);
    let rows = records.iter().map(|record| {
        let mut row = vec![
            record.file.clone(),
            record.channel.clone(),
            record.start_time.to_string(),
            record.sample_rate_hz.to_string(),
            record.samples.to_string(),
            record.unit.clone(),
            number(record.shaft_speed_hz),
            number(record.mesh_frequency_hz),
        ];
        row.extend(COLUMNS.iter().map(|name| number(record.indicators.get(name))));
        let wear = record.wear.as_ref();
        row.extend(
            [
                wear.and_then(|w| w.median_um),
                wear.and_then(|w| w.p05_um),
                wear.and_then(|w| w.p95_um),
            ]
            .map(number),
        );
        row.push(record.wear_reason.clone());
        row.push(record.basis.shaft_angle.as_ref().map_or_else(String::new, angle_words));
        row.extend(others.iter().map(|name| number(record.indicators.get(name))));
        row
    });
    let header = header.into_iter().map(str::to_owned).collect::<Vec<_>>();
    for row in std::iter::once(header).chain(rows) {
        writer
            .write_record(row)
            .expect("writing to memory does not fail, and every row has the header's width");
    }
    let bytes = writer.into_inner().expect("flushing to memory does not fail");
    String::from_utf8(bytes).expect("only text was written")
}
