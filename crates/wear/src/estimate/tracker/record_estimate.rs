//! The estimate of a record: its numbers, and its reason in words.

use super::Tracker;
use crate::estimate::comparability::Rejection;
use crate::estimate::joint_posterior::JointPosterior;
use crate::estimate::likelihood::Likelihood;
use crate::estimate::novelty::{FeatureDeviation, Novelty, SensorFault};
use crate::estimate::wear::{BaselineProgress, BestState, MissingLibrary, WearEstimate, WearStatus};
use crate::library::{Ensemble, Library, REPORTED};
use flankwatch_signal::{Features, NotComputed};

/// Widest 90 % interval, as a part of the library's depths, that still counts as an estimate.
const MAX_INTERVAL_PART: f64 = 0.6;

impl Tracker {
    /// Adds a record's novelty to an estimate without a depth, with the status and reason that follow from
    /// it.
    pub(super) fn apply_novelty(&self, estimate: &mut WearEstimate, novelty: Novelty, features: &Features) {
        if let Some(fault) = novelty.sensor_fault {
            estimate.status = WearStatus::SensorFault;
            estimate.reason = fault.words().to_owned();
        } else if let Some(fault) = novelty.suspected_fault {
            estimate.status = WearStatus::OutsideLibrary;
            let band =
                novelty.band_hz.map(|[low, high]| format!(" (mostly between {low:.0} and {high:.0} Hz)"));
            let also: Vec<&str> = novelty.other_suspected_faults.iter().map(|fault| fault.short()).collect();
            let also =
                if also.is_empty() { String::new() } else { format!("; also possible: {}", also.join(", ")) };
            let deviation = match &novelty.lasting {
                Some(check) => format!("{check} has deviated for several records"),
                None => largest_deviations(&novelty),
            };
            let words = match self.missing_library {
                MissingLibrary::NoMesh => fault.words_without_mesh(),
                _ => fault.words(),
            };
            let band = band.unwrap_or_default();
            let line = novelty.envelope_line.as_ref().map(|line| format!("; {}", line.words()));
            let line = line.unwrap_or_default();
            estimate.reason = format!("most likely: {words}{band}{also}{line}; {deviation}");
        } else if novelty.outside {
            estimate.status = WearStatus::OutsideLibrary;
            let what = match &self.ensemble {
                Some(_) if novelty.lasting.is_some() => {
                    "no wear state of the library has explained the last records well"
                }
                Some(_) => "no wear state of the library explains this record",
                None if novelty.lasting.is_some() => "the last records differ from the healthy ones",
                None => "this record differs from the healthy ones",
            };
            estimate.reason = format!("{what}; {}", largest_deviations(&novelty));
        }
        if novelty.outside && novelty.sensor_fault.is_none() && features.fault == Some(NotComputed::Clipped) {
            estimate.reason = format!("{}; {}", estimate.reason, SensorFault::Clipped.words());
        }
        estimate.novelty = Some(novelty);
    }

    /// Whether the interval is narrow enough to count as an estimate.
    pub(super) fn is_identifiable(&self, ensemble: &Ensemble, posterior: &JointPosterior) -> bool {
        let [low, high] = self.grid.interval_um(&posterior.by_depth());
        high - low <= MAX_INTERVAL_PART * ensemble.described().max_wear_um()
    }

    /// Returns the estimate of a record that wear explains.
    pub(super) fn estimate(
        &self,
        ensemble: &Ensemble,
        posterior: &JointPosterior,
        likelihood: &Likelihood,
        is_identifiable: bool,
    ) -> WearEstimate {
        let library = ensemble.described();
        let probability = posterior.by_depth();
        let quantile = |level| self.grid.quantile_um(&probability, level);
        let ([low, high], median) = (self.grid.interval_um(&probability), quantile(0.5));
        let least = quantile(0.05);
        let end_um = library.max_wear_um();
        let at_end = high >= self.grid.cell_um(REPORTED - 2)[0];
        let (status, reason) = if !is_identifiable {
            (
                WearStatus::NotIdentifiable,
                format!("any wear between {low:.0} and {high:.0} µm explains the records"),
            )
        } else if at_end {
            (
                WearStatus::Estimated,
                format!(
                    "wear of at least {least:.0} µm with 95 % probability; the library ends at {end_um:.0} µm"
                ),
            )
        } else {
            (
                WearStatus::Estimated,
                format!("wear {median:.0} µm, between {low:.0} and {high:.0} µm with 90 % probability"),
            )
        };
        let (member, depth) = likelihood.best;
        let mut estimate = self.without_depth(status, self.settings.baseline_records, &reason);
        estimate.median_um = Some(median);
        estimate.mean_um = Some(self.grid.mean_um(&probability));
        estimate.low_um = Some(low);
        estimate.p25_um = Some(quantile(0.25));
        estimate.p75_um = Some(quantile(0.75));
        estimate.high_um = Some(high);
        estimate.at_least_um = at_end.then_some(least);
        let errors = self.transmission_errors.as_ref();
        estimate.transmission_error_um = errors.and_then(|errors| errors.interval_um(&posterior.joint));
        estimate.log_evidence = likelihood.highest.is_finite().then_some(likelihood.highest.into());
        estimate.best_state = Some(best_state(library, self.grid.reported_um(depth), member));
        estimate.resolved_um = Some(likelihood.resolved(ensemble).map(|depth| self.grid.reported_um(depth)));
        estimate.posterior = Some(self.grid.posterior(&probability));
        estimate
    }

    /// Returns the estimate of a record without mesh lines: that its speed is in doubt, or `else_reason`.
    pub(super) fn without_mesh_lines(
        &self,
        features: &Features,
        have: u32,
        else_reason: &str,
    ) -> WearEstimate {
        match &features.speed_doubt {
            Some(doubt) => self.without_depth(WearStatus::SpeedInDoubt, have, doubt),
            None => self.without_depth(WearStatus::NoFeatures, have, else_reason),
        }
    }

    /// Returns the estimate of a record that cannot be compared.
    pub(super) fn not_comparable(&self, have: u32, rejection: Rejection) -> WearEstimate {
        let Rejection { reason, short } = rejection;
        let estimate = self.without_depth(WearStatus::NotComparable, have, &reason);
        WearEstimate { short_reason: Some(short), ..estimate }
    }

    /// Returns an estimate without a depth.
    pub(super) fn without_depth(&self, status: WearStatus, have: u32, reason: &str) -> WearEstimate {
        let baseline = BaselineProgress { have, need: self.settings.baseline_records };
        let ensemble = self.ensemble.as_ref();
        WearEstimate {
            library_id: ensemble.map(|ensemble| ensemble.described().id().to_owned()),
            ensemble_id: ensemble.map(|ensemble| ensemble.id().to_owned()),
            ..WearEstimate::without_number(status, reason.to_owned(), baseline)
        }
    }
}

/// The features that deviate most, in words.
fn largest_deviations(novelty: &Novelty) -> String {
    let factor = |d: &FeatureDeviation| {
        format!("{} by a factor of {:.2}", feature_words(&d.feature), d.ln_ratio.exp())
    };
    let factors: Vec<String> = novelty.largest_deviations.iter().map(factor).collect();
    format!("largest deviations: {}", factors.join(", "))
}

/// A feature in words, as `vibration around 4000 Hz` for `ln_band_4000hz`.
fn feature_words(name: &str) -> String {
    let short = name.strip_prefix("ln_").unwrap_or(name);
    let (kind, place) = short.split_once('_').unwrap_or((short, ""));
    let centre = place.strip_suffix("hz");
    match (kind, centre) {
        ("band", Some(hz)) => format!("vibration around {hz} Hz"),
        ("rest", Some(hz)) => format!("vibration between the mesh lines around {hz} Hz"),
        ("floor", Some(hz)) => format!("noise floor around {hz} Hz"),
        ("mesh", None) => format!("mesh {place}×"),
        ("sideband", None) => format!("sidebands of {place}×"),
        ("env", None) => format!("envelope of {place}×"),
        ("shaft", None) => format!("shaft {place}×"),
        ("rms", None) => "RMS".to_owned(),
        _ => short.replace('_', " "),
    }
}

/// The library state whose depth is nearest to `wear_um`.
fn best_state(library: &Library, wear_um: f64, member: usize) -> BestState {
    let distance = |index: &usize| (library.states()[*index].wear_um - wear_um).abs();
    let index = (0..library.states().len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0);
    BestState { index, wear_um: library.states()[index].wear_um, member }
}

#[cfg(test)]
mod tests {
    use super::feature_words;

    #[test]
    fn features_are_named_in_words() {
        for (name, words) in [
            ("ln_mesh_3", "mesh 3×"),
            ("ln_env_2", "envelope of 2×"),
            ("ln_band_4000hz", "vibration around 4000 Hz"),
            ("ln_floor_500hz", "noise floor around 500 Hz"),
            ("ln_rms", "RMS"),
            ("kurtosis", "kurtosis"),
        ] {
            assert_eq!(feature_words(name), words);
        }
    }
}
