//! Analysis of the records and, channel by channel, the wear estimate.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use jiff::Timestamp;

use super::AnalyzeArgs;
use super::envelope::{AnalyzedEnvelope, EnvelopeArg};
use super::record::{AnalyzedRecord, by_channel};
use super::verdict::verdict;
use crate::asset::AssetSpec;
use crate::cli::interrupt::interrupted;
use crate::cli::recordings::reading_progress::ReadingProgress;
use crate::cli::simulation::ensemble::Ensembles;
use crate::cli::{CliError, output};
use crate::estimate::{ChannelEstimator, ChannelState, EstimatorSettings, MissingLibrary, PanelChange};
use crate::library::LibraryError;
use crate::recording::{Cut, RecordDefaults, Recorded, RecordingFile, TimeOfDay};
use crate::report::{Report, ReportedAlarm, ReportedRecord};
use crate::service::ChannelUnits;
use crate::signal::{
    AnalysisSettings, Analyzer, BandSource, BearingSettings, Condition, ConditionSettings, EnvelopeBand,
    EnvelopeSearch, MeshContext, OperatingPoint, Record, ShaftSpeed, Spectrum,
};

/// The note on a recording whose records have no time.
const UNDATED: &str =
    "no time in the recording: its times count from 0; see --start-time and --time-from-name";

/// The analysed records of all files given on the command line.
pub(super) struct Analysis<'a> {
    args: &'a AnalyzeArgs,
    asset: Option<AssetSpec>,
    analyzer: Analyzer,
    units: ChannelUnits,
    pub(super) records: Vec<AnalyzedRecord>,
    last_spectrum: Option<Spectrum>,
    alarms: Vec<ReportedAlarm>,
    /// Whether a band without an envelope was reported.
    has_warned: bool,
}

impl<'a> Analysis<'a> {
    /// Creates an analysis without records.
    pub(super) fn new(args: &'a AnalyzeArgs, asset: Option<AssetSpec>) -> Self {
        let units = asset.as_ref().map(ChannelUnits::described).unwrap_or_default();
        Self {
            args,
            asset,
            units,
            analyzer: Analyzer::new(AnalysisSettings::default()),
            records: Vec::new(),
            last_spectrum: None,
            alarms: Vec::new(),
            has_warned: false,
        }
    }

    pub(super) fn report(&self) -> Report {
        Report {
            asset: self.asset.as_ref().map(|asset| asset.name_or_id().to_string()),
            limits: self.asset.as_ref().map(|asset| asset.limits).unwrap_or_default(),
            records: self.records.iter().map(ReportedRecord::from).collect(),
            has_undated: self.records.iter().any(|record| record.start_time.is_none()),
            last_spectrum: self.last_spectrum.clone(),
            alarms: self.alarms.clone(),
            ..Report::default()
        }
    }

    /// Analyses every record of a file; a recording without a time starts at `next_start`, which moves to the
    /// end of the file.
    pub(super) fn analyze_file(
        &mut self,
        path: &Path,
        next_start: &mut Timestamp,
        progress: &ReadingProgress,
    ) -> Result<(), CliError> {
        let mut defaults = RecordDefaults {
            start_time: *next_start,
            time_of_day: TimeOfDay::FromStart,
            sample_rate_hz: self.args.rate,
            unit: self.asset.as_ref().and_then(|asset| asset.sensor.unit.clone()),
            channel_units: self.asset.as_ref().map(AssetSpec::channel_units).unwrap_or_default(),
            operating_point: OperatingPoint {
                shaft_speed_hz: self.args.shaft_speed_hz,
                torque_nm: self.args.torque_nm,
                ..OperatingPoint::default()
            },
            ..RecordDefaults::default()
        };
        self.args.values.apply(path, &mut defaults)?;
        let cut = self.args.record_seconds.map(Cut::Seconds);
        let mut file = RecordingFile::open_channels(path, &self.args.channels, defaults, cut)
            .map_err(CliError::recording(path))?;
        if let Some(seconds) = file.default_cut_seconds() {
            progress.print(&format!(
                "note: {}: long recording split into records of {seconds} s; set another length with --record-seconds",
                path.display()
            ));
        }
        if let Some(note) = self.args.values.note(path, self.args.rate, &file) {
            progress.print(&note);
        }
        let mut undated = None;
        while let Some(recorded) = file.next() {
            let recorded = recorded.map_err(CliError::recording(path))?;
            if !self.args.values.is_dated(recorded.record.start_time()) {
                undated
                    .get_or_insert_with(|| progress.print(&format!("note: {}: {UNDATED}", path.display())));
            }
            *next_start = self.args.values.next_start(*next_start, recorded.record.end_time());
            self.analyze_record(path, recorded, progress)?;
            progress.set_read(file.bytes_read());
        }
        *next_start =
            file.end_time().map_or(*next_start, |end| self.args.values.next_start(*next_start, end));
        Ok(())
    }

    fn analyze_record(
        &mut self,
        path: &Path,
        recorded: Recorded,
        progress: &ReadingProgress,
    ) -> Result<(), CliError> {
        // One channel has one unit, as in the service.
        self.units.learn_unit(&recorded.record);
        let (record, _) = self.units.convert(recorded.record).map_err(CliError::file(path))?;
        // Without a description there is no mesh, so its indicators are not listed as absent either.
        let undescribed = ConditionSettings {
            mesh: MeshContext::unknown(),
            bands: &[],
            gear_indicators: false,
            bearings: BearingSettings::default(),
        };
        let bearings = self.asset.as_ref().map_or_else(Vec::new, AssetSpec::bearings);
        let settings = self.asset.as_ref().map_or(undescribed, |asset| asset.condition_settings(&bearings));
        let at_shaft =
            self.asset.as_ref().map_or(Cow::Borrowed(&record), |asset| asset.seen_from_shaft(&record));
        let Condition { analysis, basis } = self.analyzer.condition(&at_shaft, &settings);
        let envelope =
            self.args.envelope.map(|arg| self.envelope(&record, analysis.shaft_speed.as_ref(), arg));
        if let Some(reason) = envelope.as_ref().and_then(|envelope| envelope.absent.as_ref())
            && !self.has_warned
        {
            self.has_warned = true;
            progress.print(&format!("warning: {}: no envelope spectrum: {reason}", path.display()));
        }
        if self.args.report.is_some() {
            self.last_spectrum = Some(self.analyzer.amplitude_spectrum(&record));
        }
        self.records.push(AnalyzedRecord {
            file: path.display().to_string(),
            channel: record.channel().to_owned(),
            start_time: Some(record.start_time()).filter(|time| self.args.values.is_dated(*time)),
            time: record.start_time(),
            sample_rate_hz: record.sample_rate_hz(),
            samples: record.samples().len(),
            unit: record.unit().to_owned(),
            shaft_speed_hz: analysis.shaft_speed.map(|speed| speed.shaft_speed_hz),
            shaft_speed_source: analysis.shaft_speed.map(|speed| speed.source),
            shaft_speed_doubt: analysis.shaft_speed.and_then(|speed| speed.doubt),
            mesh_frequency_hz: analysis
                .shaft_speed
                .map(|speed| speed.mesh_frequency_hz)
                .filter(|&hz| hz > 0.0),
            basis,
            velocity_zone: self.asset.as_ref().and_then(|asset| asset.velocity_zone(&analysis.indicators)),
            indicators: analysis.indicators,
            envelope,
            wear: None,
            wear_reason: "no asset description, see --asset".to_owned(),
            reference_wear_um: recorded.reference_wear_um,
            has_mesh: self.asset.as_ref().is_some_and(|asset| asset.gear.is_some()),
            has_pair: self.asset.as_ref().is_some_and(|asset| asset.pair().is_some()),
            shaft_speed: analysis.shaft_speed,
            features: analysis.features,
        });
        Ok(())
    }

    fn envelope(
        &mut self,
        record: &Record,
        speed: Option<&ShaftSpeed>,
        arg: EnvelopeArg,
    ) -> AnalyzedEnvelope {
        let asset = self.asset.as_ref();
        let search = match arg {
            EnvelopeArg::Search(search) => search,
            _ => asset.map_or_else(EnvelopeSearch::default, |asset| asset.envelope_band),
        };
        let given = match arg {
            EnvelopeArg::Hertz(band_hz) => Some(EnvelopeBand::given(band_hz, BandSource::Query)),
            EnvelopeArg::Asset => asset.and_then(AssetSpec::given_envelope_band),
            EnvelopeArg::Search(_) => None,
        };
        let band = given.unwrap_or_else(|| self.analyzer.envelope_band(record, speed, search));
        let spectrum = self.analyzer.envelope_spectrum(record, band.band_hz);
        AnalyzedEnvelope::new(band, &spectrum)
    }

    /// Estimates wear from each channel's records in time order, as the service does. While the ensemble is
    /// not complete, prints a provisional estimate from its first members and simulates the rest; Ctrl-C
    /// keeps the provisional estimate. After an error the records say why they have no estimate.
    pub(super) fn estimate_wear(&mut self) -> Result<(), CliError> {
        let Some(asset) = &self.asset else { return Ok(()) };
        let settings = EstimatorSettings {
            baseline_records: asset.baseline.records,
            limit_um: asset.limits.danger_um.or(asset.limits.warning_um),
        };
        let rules = asset.alarm_rules();
        if asset.gear.is_none() {
            self.fold(&ChannelEstimator::without_library(settings, MissingLibrary::NoMesh, rules));
            return Ok(());
        }
        // Simulate a library only if some channel has records after its baseline.
        let needed = by_channel(&self.records)
            .values()
            .any(|records| records.len() > settings.baseline_records as usize);
        let Some(pair) = asset.pair().filter(|_| needed) else {
            self.fold(&ChannelEstimator::new(settings, None, rules));
            return Ok(());
        };
        let ensembles = Ensembles::new(&self.args.data_dir, self.args.members);
        let interrupted = interrupted();
        let first = match ensembles.first(pair, Some(&interrupted)) {
            Ok(first) => Arc::new(first),
            Err(error) => {
                let missing = MissingLibrary::Failed(error.to_string());
                self.fold(&ChannelEstimator::without_library(settings, missing, rules));
                return Err(error.into());
            }
        };
        if ensembles.is_complete(&first) {
            self.fold(&ChannelEstimator::new(settings, Some(first), rules));
            return Ok(());
        }
        self.fold(&ChannelEstimator::provisional(settings, Arc::clone(&first), rules.clone()));
        let (have, all) = (first.members().len(), ensembles.members());
        for (channel, records) in by_channel(&self.records) {
            let verdict = verdict(&records);
            output::print_stderr(&format!(
                "channel {channel}, with {have} of {all} ensemble members: {verdict}"
            ));
        }
        match ensembles.complete(&first, Some(&interrupted)) {
            Ok(complete) => self.fold(&ChannelEstimator::new(settings, Some(Arc::new(complete)), rules)),
            Err(LibraryError::Cancelled) => {
                output::print_stderr(
                    "interrupted: the estimates are provisional; run the command to its end for final ones",
                );
            }
            Err(error) => return Err(error.into()),
        }
        Ok(())
    }

    fn fold(&mut self, estimator: &ChannelEstimator) {
        let mut order: Vec<usize> = (0..self.records.len()).collect();
        order.sort_by_key(|&i| self.records[i].time);
        let mut channels: BTreeMap<String, (ChannelState, Vec<PanelChange>)> = BTreeMap::new();
        for index in order {
            let record = &mut self.records[index];
            let channel = channels.entry(record.channel.clone());
            let (state, changes) = channel.or_insert_with(|| (estimator.start(), Vec::new()));
            let result = estimator.record(state, record.time, &record.features, &record.indicators);
            record.indicators.extend(result.indicators);
            changes.extend(result.changes);
            record.wear_reason = result.wear.reason.clone();
            record.wear = Some(result.wear);
        }
        let rules = estimator.rules();
        let reported = channels
            .iter()
            .flat_map(|(channel, (_, changes))| ReportedAlarm::of_changes(channel, rules, changes));
        self.alarms = reported.collect();
    }
}
