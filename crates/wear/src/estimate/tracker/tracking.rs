//! Tracking wear record by record after the baseline.

use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::Tracker;
use super::healthy::{CachedModel, HealthyModel};
use crate::estimate::anchor::Anchor;
use crate::estimate::baseline::Baseline;
use crate::estimate::comparability::{Rejection, sampled_too_slowly};
use crate::estimate::cusum::Cusums;
use crate::estimate::depth_grid::DepthGrid;
use crate::estimate::deviation::Deviation;
use crate::estimate::event::Inspection;
use crate::estimate::expectation::{Expectations, Reference};
use crate::estimate::extrapolation::Extrapolation;
use crate::estimate::filter::Filter;
use crate::estimate::growth::Jumps;
use crate::estimate::growth_clock::{GrowthClock, Signs, baseline_interval_s};
use crate::estimate::healthy_checks::Drift;
use crate::estimate::joint_posterior::JointPosterior;
use crate::estimate::levels::{Levels, is_impulsive};
use crate::estimate::likelihood::Likelihood;
use crate::estimate::line_motion::LineMotion;
use crate::estimate::measured_lines::MeasuredLines;
use crate::estimate::novelty::{Novelty, RecordContext, SensorFault, judge};
use crate::estimate::prognosis::Outlook;
use crate::estimate::sudden_change::SuddenChange;
use crate::estimate::trend::Trend;
use crate::estimate::wear::{WearEstimate, WearStatus};
use crate::library::{DEPTHS, Ensemble, Member};
use flankwatch_signal::Features;

/// Fewest lines that a comparison needs.
const MIN_LINES: usize = 3;

/// Records in a row whose own best depth may lie outside the interval before the estimate is withdrawn.
const MAX_DISAGREEING: u8 = 10;

/// Records in a row whose own best depth is greater than this quantile before wear counts as deeper than
/// expected.
const MIN_DEEPER: u8 = 3;
const DEEPER: f64 = 0.9;

/// Probability that a load moved the lines, where they moved as load moves them or all at once.
const LOAD_INSTEAD: f32 = 0.2;

/// Caveat on lines that moved as load moves them.
const LIKE_LOAD: &str = "a change of load may be the cause instead: the lines moved together as they do in the baseline; supply the torque with each record";

/// Caveat on lines that changed from one record to the next.
const SUDDEN: &str = "the lines changed suddenly, which a change of load may have caused instead: supply the torque with each record, inspect the teeth, or report a new operating regime";

/// State of a channel after its baseline.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Tracking {
    /// Shared with the states after it.
    baseline: Arc<Baseline>,
    pub(super) clock: GrowthClock,
    /// Time of the newest record that was compared with the library.
    seen: Timestamp,
    drift: Drift,
    pub(super) filter: Option<Filter>,
    /// By member, the index of the depth at which the baseline was taken; `None` for a new machine.
    reference: Option<Vec<u8>>,
    anchor: Option<Anchor>,
    motion: LineMotion,
    /// Number of records in a row whose own best depth lies outside the interval.
    disagreeing: u8,
    /// Number of records in a row whose own best depth is greater than nearly all of the probability.
    deeper: u8,
    #[serde(default, rename = "charts")]
    cusums: Cusums,
    #[serde(default)]
    levels: Levels,
    #[serde(default)]
    sudden: SuddenChange,
    /// Number of records that the baseline could not have, where they are more than it has. How worn the
    /// teeth were when it was taken is then not known, until the teeth are inspected.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) passed_over: Option<u32>,
    trend: Trend,
    #[serde(skip)]
    model: CachedModel,
    /// Probability of each group of members after a later inspection, for estimates in hindsight.
    #[serde(skip)]
    pub(super) hindsight: Option<Arc<[f32]>>,
}

impl Tracking {
    #[cfg(test)]
    pub(super) fn baseline(&self) -> &Arc<Baseline> {
        &self.baseline
    }

    /// Whether all it knows of the members is of this number of them, in groups of `variants`.
    pub(super) fn fits(&self, members: usize, variants: usize) -> bool {
        let depths = self.reference.iter().chain(self.anchor.as_ref().map(|anchor| &anchor.depths));
        let is_of_members = |depths: &Vec<u8>| {
            depths.len() == members && depths.iter().all(|depth| usize::from(*depth) < DEPTHS)
        };
        depths.into_iter().all(is_of_members)
            && self.filter.as_ref().is_none_or(|filter| filter.fits(members, variants))
    }

    /// Takes an inspection of the teeth as the anchor, and as the end of a sudden change.
    pub(super) fn add_inspection(&mut self, ensemble: &Ensemble, inspection: &Inspection) {
        let Inspection { depth_um, place, .. } = *inspection;
        self.anchor = Some(Anchor {
            depths: Anchor::depths_at(ensemble, depth_um, inspection.gear_index(), place),
            changes: self.motion.last().to_vec(),
        });
        self.disagreeing = 0;
        self.passed_over = None;
        self.clock.inspect();
        self.trend.inspect();
        self.sudden.restart();
    }

    /// Judges a record by its deviations of lines and checks; `gain_sensitive` are the values that a gain
    /// multiplies.
    fn judge(
        &mut self,
        healthy: &HealthyModel,
        features: &Features,
        deviations: [Vec<Deviation>; 2],
        gain_sensitive: &[Deviation],
        lines_fell: Option<bool>,
    ) -> Novelty {
        let freedom = healthy.checks.freedom();
        let kurtosis = healthy.checks.kurtosis(features, healthy.lines.log_speed(features));
        let gain = self.levels.gain(gain_sensitive, kurtosis.as_ref(), freedom);
        let impulsive = kurtosis.as_ref().is_some_and(is_impulsive);
        let context = RecordContext { gain, impulsive, lines_fell };
        let novelty = judge(features, &deviations, freedom, context, &mut self.cusums);
        if novelty.outside {
            let named = novelty.sensor_fault == Some(SensorFault::GainChanged);
            self.levels.add_unexplained(gain.filter(|_| named));
        } else {
            self.levels.add_explained(gain_sensitive.iter().chain(&kurtosis));
        }
        novelty
    }
}

impl Tracker {
    /// Starts tracking after a baseline of these records, the first two of which began at `first`; it ended
    /// at `ended`.
    pub(super) fn start_tracking(
        &self,
        records: &[Arc<Features>],
        first: [Timestamp; 2],
        ended: Timestamp,
        carried: Option<Filter>,
    ) -> Tracking {
        let interval_s = baseline_interval_s(first, ended, records.len());
        let filter = carried.filter(|filter| filter.fits(self.members(), self.variants()));
        Tracking {
            baseline: Arc::new(Baseline::of(records)),
            clock: GrowthClock::start(ended, interval_s),
            seen: ended,
            drift: Drift::default(),
            reference: filter.as_ref().map(Filter::mean_depths),
            filter,
            anchor: None,
            motion: LineMotion::default(),
            disagreeing: 0,
            deeper: 0,
            cusums: Cusums::default(),
            levels: Levels::default(),
            sudden: SuddenChange::default(),
            passed_over: None,
            trend: Trend::start(ended),
            model: CachedModel::default(),
            hindsight: None,
        }
    }

    /// Returns a filter, or that of a new machine, after a depth was measured on the teeth.
    pub(super) fn inspected(
        &self,
        ensemble: &Ensemble,
        filter: Option<Filter>,
        inspection: &Inspection,
    ) -> Filter {
        let mut filter = self.filter_for(filter);
        let tracked = DepthGrid::of(ensemble.depths_um());
        let at_place = |member: &Member| member.at_place(inspection.gear_index(), inspection.place);
        let middle = |[low, high]: [f64; 2]| 0.5 * (low + high);
        // Beyond the tracked depths no member is likelier than another: the deepest are the nearest.
        let deepest = |member: &Member| {
            let depths_um = tracked.cells().zip(at_place(member));
            depths_um.map(|(cell, part)| middle(cell) * f64::from(part)).fold(0.0, f64::max)
        };
        let deepest_um = ensemble.members().iter().map(deepest).fold(0.0, f64::max);
        let depth_um = inspection.depth_um.min(deepest_um);
        let likelihood: Vec<f32> = ensemble
            .members()
            .iter()
            .flat_map(|member| {
                let parts = at_place(member);
                let deviates = tracked.cells().zip(parts).map(|([low, high], part)| {
                    // The variance is the measurement's plus that of a uniform distribution over the cell.
                    let (middle, width) =
                        (middle([low, high]) * f64::from(part), (high - low) * f64::from(part));
                    let variance = inspection.error_um * inspection.error_um + width * width / 12.0;
                    (-0.5 * (depth_um - middle).powi(2) / variance).exp().max(1e-30) as f32
                });
                deviates.collect::<Vec<_>>()
            })
            .collect();
        filter.inspect(&likelihood);
        filter
    }

    /// Compares one record with the library, updates the state and returns the estimate.
    pub(super) fn track(&self, tracking: &mut Tracking, at: Timestamp, features: &Features) -> WearEstimate {
        let need = self.settings.baseline_records;
        let Tracking { baseline, model, .. } = &mut *tracking;
        let healthy = model.get(|| self.healthy_model(baseline));
        if let Some(rejection) = tracking.baseline.comparability.rejection(features) {
            return self.not_comparable(need, rejection);
        }
        let (Some(ensemble), Some(discrepancy)) = (self.ensemble.as_deref(), &self.discrepancy) else {
            let reason = "no gear pair is described for this asset, so there is no library to compare with";
            let estimate = match &features.speed_doubt {
                Some(doubt) => self.without_depth(WearStatus::SpeedInDoubt, need, doubt),
                None => self.without_depth(WearStatus::NoLibrary, need, reason),
            };
            return self.track_by_checks(tracking, &healthy, features, estimate);
        };
        if healthy.lines.len() < MIN_LINES {
            let reason = format!(
                "{} mesh lines stand above the noise in the baseline, expected at least {MIN_LINES}: this channel cannot show wear",
                healthy.lines.len()
            );
            let estimate = self.without_depth(WearStatus::NotIdentifiable, need, &reason);
            return self.track_by_checks(tracking, &healthy, features, estimate);
        }
        let extrapolation = Extrapolation::of(ensemble, features);
        if let Some(rejection) = extrapolation.rejection() {
            return self.not_comparable(need, rejection);
        }
        let scatter = tracking.baseline.comparability.scatter(features);
        let measured = healthy.lines.measure(features, scatter);
        if let Some(rejection) = sampling_rejection(&healthy, ensemble, &measured, features) {
            return self.not_comparable(need, rejection);
        }
        if measured.lines.is_empty() {
            return self.track_without_lines(tracking, &healthy, features);
        }
        let reference = Reference {
            depths: tracking.reference.as_deref(),
            anchor: tracking.anchor.as_ref(),
            extrapolation,
        };
        let expectations = Expectations::of(discrepancy, ensemble, &measured, reference);
        let likelihood = Likelihood::of(&expectations);
        let lines = expectations.deviations(likelihood.best);
        let line_spread = measured.line_spread();
        let unseen = tracking.clock.intervals(tracking.seen, at).max(1.0);
        tracking.seen = at.max(tracking.seen);
        let checks = healthy.checks_at(features, likelihood.best.1, tracking.drift.at(line_spread, unseen));
        let drift = tracking.drift.after(line_spread, unseen, &checks);
        let mesh_hz = f64::from(ensemble.described().pair().geometry.teeth[0])
            * features.operating_point.shaft_speed_hz.unwrap_or(0.0);
        let mut gain_sensitive = healthy.checks.gain_sensitive(features, healthy.lines.log_speed(features));
        gain_sensitive.extend(measured.deviations());
        let lines_fell = tracking.levels.lines_fell(&gain_sensitive, &measured.frequencies_hz(mesh_hz));
        let novelty = tracking.judge(&healthy, features, [lines, checks], &gain_sensitive, lines_fell);
        if novelty.outside {
            // A record that wear does not explain leaves the wear estimate as it is.
            let mut estimate = self.without_depth(WearStatus::OutsideLibrary, need, "");
            self.apply_novelty(&mut estimate, novelty, features);
            return estimate;
        }
        tracking.drift = drift;
        let mut posterior = self.update_filter(tracking, at, &measured, &likelihood);
        if let Some(passed_over) = tracking.passed_over {
            let reason = format!(
                "how worn the teeth were at the baseline is not known: {passed_over} records before its end were clipped or had a speed in doubt, more than it has; inspect the teeth, or choose the baseline"
            );
            let mut estimate = self.without_depth(WearStatus::NotIdentifiable, need, &reason);
            estimate.novelty = Some(novelty);
            return estimate;
        }
        if let Some(groups) = &tracking.hindsight {
            posterior = posterior.with_groups(groups);
        }
        let like_load = healthy.lines.moved_like_load(features, &measured);
        if like_load {
            posterior = posterior.or_depths(&[1.0], LOAD_INSTEAD);
        }
        // A sudden change widens the interval, and does not take the estimate away.
        let is_identifiable = self.is_identifiable(ensemble, &posterior);
        let torque_nm = features.operating_point.torque_nm;
        let before = tracking.sudden.before().filter(|_| torque_nm.is_none());
        let is_beyond = before.is_some_and(|before| self.is_beyond(&posterior, before));
        if let Some(before) = before {
            posterior = posterior.or_depths(before, LOAD_INSTEAD);
        }
        let mut estimate = self.estimate(ensemble, &posterior, &likelihood, is_identifiable);
        let best_um = self.grid.reported_um(likelihood.best.1);
        let by_depth = posterior.by_depth();
        let [low_um, high_um] = [0.05, 0.95].map(|level| self.grid.quantile_um(&by_depth, level));
        let is_outside = best_um < low_um || best_um > high_um;
        tracking.disagreeing = counted(tracking.disagreeing, is_outside);
        let is_disputed = tracking.disagreeing >= MAX_DISAGREEING && estimate.status == WearStatus::Estimated;
        if is_disputed {
            estimate.status = WearStatus::NotIdentifiable;
        }
        // Beyond the library, depths cannot be told apart.
        let hidden_limit_um = self.settings.limit_um.filter(|limit_um| {
            *limit_um >= ensemble.described().max_wear_um() && estimate.at_least_um.is_some()
        });
        let doubts = [
            is_disputed.then(|| "; the last records contradict the earlier ones".to_owned()),
            extrapolation.caveat().map(|caveat| format!("; {caveat}")),
            like_load.then(|| format!("; {LIKE_LOAD}")),
            is_beyond.then(|| format!("; {SUDDEN}")),
            hidden_limit_um.map(|limit_um| {
                format!("; the limit of {limit_um:.0} µm lies beyond that: whether wear has passed it is not known")
            }),
        ];
        estimate.reason.extend(doubts.into_iter().flatten());
        if let Some(limit_um) = self.settings.limit_um {
            let age_s = tracking.clock.age_s();
            let outlook = Outlook {
                depths_um: ensemble.depths_um(),
                by_depth: &by_depth,
                standstill: posterior.standstill,
                rates_um_per_day: tracking.trend.rates_um_per_day(age_s),
                age_s,
            };
            estimate.prognosis = outlook.prognosis(limit_um, at);
            let above = self.grid.probability_above(&by_depth, limit_um);
            estimate.above_limit = hidden_limit_um.is_none().then_some(above);
        }
        estimate.novelty = Some(novelty);
        estimate
    }

    /// Judges a record without comparable mesh lines; adds its novelty to the `estimate` that says why.
    fn track_by_checks(
        &self,
        tracking: &mut Tracking,
        healthy: &HealthyModel,
        features: &Features,
        mut estimate: WearEstimate,
    ) -> WearEstimate {
        let need = self.settings.baseline_records;
        let [healthy_checks, shared] = healthy.checks.shared(features);
        if features.fault.is_none() && 2 * shared < healthy_checks {
            if features.speed_doubt.is_some() {
                return self.without_mesh_lines(features, need, "");
            }
            return self.not_comparable(
                need,
                Rejection {
                    reason: format!(
                        "not comparable with the baseline: it has {shared} of the baseline's {healthy_checks} bands and lines; its sampling rate or length probably differs"
                    ),
                    short: format!("{shared} of {healthy_checks} bands and lines"),
                },
            );
        }
        let gain_sensitive = healthy.checks.gain_sensitive(features, healthy.lines.log_speed(features));
        let checks = healthy.checks_at(features, 0, Drift::default().at(0.0, 1.0));
        let novelty = tracking.judge(healthy, features, [Vec::new(), checks], &gain_sensitive, None);
        self.apply_novelty(&mut estimate, novelty, features);
        estimate
    }

    /// Judges a record that has none of the baseline's lines. Values below the healthy ones are ignored:
    /// they mean that the machine stands still.
    fn track_without_lines(
        &self,
        tracking: &mut Tracking,
        healthy: &HealthyModel,
        features: &Features,
    ) -> WearEstimate {
        let need = self.settings.baseline_records;
        let mut estimate =
            self.without_mesh_lines(features, need, "this record has none of the baseline's mesh lines");
        let mut checks = healthy.checks_at(features, 0, Drift::default().at(0.0, 1.0));
        checks.retain(|deviation| deviation.residual > 0.0);
        let context = RecordContext { impulsive: healthy.is_impulsive(features), ..RecordContext::default() };
        let freedom = healthy.checks.freedom();
        let novelty = judge(features, &[Vec::new(), checks], freedom, context, &mut tracking.cusums);
        self.apply_novelty(&mut estimate, novelty, features);
        estimate
    }

    /// Whether wear is probably deeper than it can have been by the probability `before`.
    fn is_beyond(&self, posterior: &JointPosterior, before: &[f32]) -> bool {
        let before: Vec<f64> = before.iter().map(|p| f64::from(*p)).collect();
        self.grid.quantile_um(&posterior.by_depth(), 0.5) > self.grid.quantile_um(&before, 0.95)
    }

    /// Lets wear grow up to a record, then updates the filter with the record.
    fn update_filter(
        &self,
        tracking: &mut Tracking,
        at: Timestamp,
        measured: &MeasuredLines,
        likelihood: &Likelihood,
    ) -> JointPosterior {
        let moving = tracking.motion.add(measured);
        let signs = Signs { deeper: tracking.deeper >= MIN_DEEPER, moving };
        let elapsed = tracking.clock.advance(at, measured.load, signs);
        let filter = self.filter_for(tracking.filter.take());
        let filter = tracking.filter.insert(filter);
        let is_inspected = tracking.anchor.is_some();
        let posterior = filter.update(&self.growth, elapsed, likelihood, is_inspected);
        // In a gap wear may grow as well as the load may change.
        if elapsed.jumps == Jumps::InGap {
            tracking.sudden.restart();
        }
        let by_depth = posterior.by_depth();
        tracking.trend.add(at, self.grid.mean_um(&by_depth), tracking.clock.age_s());
        tracking.sudden.add(measured, &by_depth);
        // Of the filter itself: hindsight changes the estimate, and must not change the filter.
        let most_um = self.grid.quantile_um(&by_depth, DEEPER);
        let is_deeper = self.grid.reported_um(likelihood.best.1) > most_um;
        tracking.deeper = counted(tracking.deeper, is_deeper);
        posterior
    }
}

/// Counts records in a row of which something holds.
fn counted(so_far: u8, holds: bool) -> u8 {
    if holds { so_far.saturating_add(1) } else { 0 }
}

/// Returns why a record is rejected where its sampling rate leaves it too few of the baseline's lines.
fn sampling_rejection(
    healthy: &HealthyModel,
    ensemble: &Ensemble,
    measured: &MeasuredLines,
    features: &Features,
) -> Option<Rejection> {
    let speed_hz = features.operating_point.shaft_speed_hz.filter(|_| measured.lines.len() < MIN_LINES)?;
    let teeth = f64::from(ensemble.described().pair().geometry.teeth[0]);
    sampled_too_slowly(features, healthy.lines.rate_needed_hz(MIN_LINES, teeth * speed_hz))
}
