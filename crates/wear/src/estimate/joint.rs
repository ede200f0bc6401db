//! The joint estimate of all channels of a mesh.
//!
//! It follows from the latest estimates of the channels alone, so the order in which their records arrived
//! does not matter. Each channel's novelty already pools its own records (`cusum`); here the channels'
//! evidence is pooled, and the depth distributions of the channels that wear explains are mixed.

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};

use super::depth_grid::DepthGrid;
use super::deviation::normal_tail;
use super::novelty::{MIN_P_VALUE, Novelty};
use super::wear::{Interval, WearEstimate, WearStatus};

/// Assumed correlation between the channels' deviations: load and temperature move them together.
const CORRELATION: f64 = 0.7;

/// Below this p-value, a channel is named as contributing.
const CONTRIBUTING_P_VALUE: f64 = 0.05;

/// A channel that has missed more than this many records, while another channel continued, is silent.
const MAX_MISSED_RECORDS: i32 = 10;

/// Widest 90 % interval of a mixture, as a part of the library's depths, that still counts as an estimate.
const MAX_MIXTURE_PART: f64 = 0.6;

/// Contribution of one channel to the joint estimate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ChannelContribution {
    /// The channel.
    pub channel: String,
    /// Status of its latest estimate.
    pub status: WearStatus,
    /// Reason of its latest estimate, in words.
    pub reason: String,
    /// −log₁₀ of the probability that a healthy channel deviates as much; absent where not judged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub novelty_score: Option<f64>,
    /// Its own median wear depth in µm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub median_um: Option<f64>,
    /// Lower end of its own 90 % interval in µm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub low_um: Option<f64>,
    /// Upper end of this interval in µm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub high_um: Option<f64>,
    /// Start of its latest record, where the channel is silent and so not included in the estimate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub silent_since: Option<Timestamp>,
}

/// Times of a channel's records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RecordTimes {
    /// Start of the earliest one.
    pub first: Timestamp,
    /// Start of the latest one.
    pub latest: Timestamp,
    /// How many there are.
    pub count: u64,
}

impl RecordTimes {
    /// Mean time from one record to the next; `None` for a single record.
    fn interval(&self) -> Option<SignedDuration> {
        let intervals = i32::try_from(self.count).unwrap_or(i32::MAX) - 1;
        (intervals > 0).then(|| self.latest.duration_since(self.first) / intervals)
    }

    /// Whether this channel has stopped while others continued. `newest` is the latest record of all
    /// channels; `usual` is the interval assumed for a channel with a single record.
    fn is_silent(&self, newest: Timestamp, usual: SignedDuration) -> bool {
        newest.duration_since(self.latest) > self.interval().unwrap_or(usual) * MAX_MISSED_RECORDS
    }

    /// Returns which of an asset's channels are silent. The one with the newest record never is.
    pub fn silent(channels: &[Self]) -> Vec<bool> {
        let newest = channels.iter().map(|times| times.latest).max().unwrap_or_default();
        let usual = channels
            .iter()
            .filter_map(Self::interval)
            .max()
            .unwrap_or(SignedDuration::MAX / MAX_MISSED_RECORDS);
        channels.iter().map(|times| times.is_silent(newest, usual)).collect()
    }
}

/// The joint estimate of an asset.
#[derive(Debug, Clone, PartialEq)]
pub struct JointEstimate {
    /// Index of the leading channel, whose estimate the joint one is based on.
    pub leading: usize,
    /// The estimate.
    pub wear: WearEstimate,
    /// Contribution of each channel, in their order.
    pub channels: Vec<ChannelContribution>,
}

impl JointEstimate {
    /// Joins the latest estimates of an asset's channels; `None` without channels. Of several channels of the
    /// same rank, the first one leads.
    pub fn of(latest: &[(&str, &WearEstimate)]) -> Option<Self> {
        let (_, first) = latest.first()?;
        let channels = latest.iter().map(|(channel, wear)| ChannelContribution::of(channel, wear)).collect();
        if latest.len() == 1 {
            return Some(Self { leading: 0, wear: (*first).clone(), channels });
        }
        let pooled = pooled_p_value(latest.iter().filter_map(|(_, wear)| judged(wear)));
        let mut leading = leading(latest);
        let mut wear = latest[leading].1.clone();
        let alone = wear.status == WearStatus::OutsideLibrary;
        // The rest of the library may still explain what its first part does not.
        let is_open = latest.iter().any(|(_, wear)| wear.status == WearStatus::Provisional);
        match pooled {
            Some(p_value) if !alone && !is_open && p_value < MIN_P_VALUE => {
                leading = most_novel(latest).unwrap_or(leading);
                wear = jointly_outside(latest, leading, p_value);
            }
            _ if wear.status == WearStatus::Estimated => mix(latest, &mut wear),
            _ => {}
        }
        if let Some(p_value) = pooled
            && let Some(novelty) = &mut wear.novelty
            && novelty.sensor_fault.is_none()
        {
            // Channels that notice nothing do not weaken the evidence of one that stands out by itself.
            novelty.p_value = if alone { novelty.p_value.min(p_value) } else { p_value };
            novelty.score = Novelty::score_of(novelty.p_value);
        }
        if wear.status != WearStatus::SensorFault {
            for (channel, other) in latest.iter().filter(|(_, wear)| wear.status == WearStatus::SensorFault) {
                wear.reason = format!("{}; channel {channel}: {}", wear.reason, other.reason);
            }
        }
        if alone {
            wear.reason = format!("channel {}: {}", latest[leading].0, wear.reason);
        }
        Some(Self { leading, wear, channels })
    }

    /// Adds a silent channel, which is not included in the estimate, to the reason and the contributions.
    pub fn add_silent_channel(&mut self, channel: &str, wear: &WearEstimate, since: Timestamp) {
        self.wear.reason =
            format!("{}; channel {channel} is not included: no record since {since:.0}", self.wear.reason);
        let silent =
            ChannelContribution { silent_since: Some(since), ..ChannelContribution::of(channel, wear) };
        self.channels.push(silent);
    }
}

impl ChannelContribution {
    fn of(channel: &str, wear: &WearEstimate) -> Self {
        Self {
            channel: channel.to_owned(),
            status: wear.status,
            reason: wear.reason.clone(),
            novelty_score: wear.novelty.as_ref().map(|novelty| novelty.score),
            median_um: wear.median_um,
            low_um: wear.low_um,
            high_um: wear.high_um,
            silent_since: None,
        }
    }
}

/// How important a channel's latest estimate is for the machine's.
fn priority(status: WearStatus) -> u8 {
    match status {
        WearStatus::OutsideLibrary => 4,
        WearStatus::Estimated => 3,
        WearStatus::NotIdentifiable | WearStatus::Provisional => 2,
        WearStatus::SensorFault => 1,
        _ => 0,
    }
}

/// Returns the channel of the highest priority: of several outside the library the one with the highest
/// novelty, else the first.
fn leading(latest: &[(&str, &WearEstimate)]) -> usize {
    let rank = |wear: &WearEstimate| {
        let score = wear.novelty.as_ref().map_or(0.0, |novelty| novelty.score);
        (priority(wear.status), if wear.status == WearStatus::OutsideLibrary { score } else { 0.0 })
    };
    let mut best = 0;
    for (n, (_, wear)) in latest.iter().enumerate().skip(1) {
        if rank(wear) > rank(latest[best].1) {
            best = n;
        }
    }
    best
}

/// Returns the channel with the highest novelty.
fn most_novel(latest: &[(&str, &WearEstimate)]) -> Option<usize> {
    let scores = latest.iter().enumerate().filter_map(|(n, (_, wear))| Some((n, judged(wear)?)));
    scores.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(n, _)| n)
}

/// Returns the p-value of a channel's novelty, where the record was judged and the sensor has no fault.
fn judged(wear: &WearEstimate) -> Option<f64> {
    let novelty = wear.novelty.as_ref().filter(|novelty| novelty.sensor_fault.is_none())?;
    Some(novelty.p_value)
}

/// Pools the p-values of channels; `None` without channels.
///
/// The first of two tests takes the smallest p-value times the number of channels (Bonferroni), the second
/// the sum of normal deviates with the variance that their correlation gives (Stouffer 1949). The result is
/// twice the smaller of both, as two tests are made.
fn pooled_p_value(p_values: impl Iterator<Item = f64>) -> Option<f64> {
    let (mut count, mut least, mut sum) = (0.0, 1.0_f64, 0.0);
    for p in p_values {
        count += 1.0;
        least = least.min(p);
        // A channel that deviates less than the median is no evidence against the others.
        sum += normal_deviate(p).max(0.0);
    }
    if count == 0.0 {
        return None;
    }
    if count == 1.0 {
        return Some(least);
    }
    let variance = count + count * (count - 1.0) * CORRELATION;
    Some((2.0 * (count * least).min(normal_tail(sum / f64::sqrt(variance)))).min(1.0))
}

/// Returns the normal deviate whose upper tail is `p`, from 0 (p of ½ and above) to 12.
fn normal_deviate(p: f64) -> f64 {
    let (mut low, mut high) = (0.0, 12.0);
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if normal_tail(middle) > p { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// Returns the estimate where no channel stands out by itself, but all channels together do.
fn jointly_outside(latest: &[(&str, &WearEstimate)], leading: usize, p_value: f64) -> WearEstimate {
    let leader = latest[leading].1;
    let part = |(channel, wear): &(&str, &WearEstimate)| {
        let p = judged(wear).filter(|p| *p < CONTRIBUTING_P_VALUE)?;
        Some(format!("{channel} (novelty {:.1})", Novelty::score_of(p)))
    };
    let parts: Vec<String> = latest.iter().filter_map(part).collect();
    let what = match leader.library_id {
        Some(_) => "no wear explains the channels together",
        None => "the channels together differ from the healthy ones",
    };
    let reason = format!("{what}, although none of them stands out alone: {}", parts.join(", "));
    let mut wear = WearEstimate {
        library_id: leader.library_id.clone(),
        ensemble_id: leader.ensemble_id.clone(),
        ..WearEstimate::without_number(WearStatus::OutsideLibrary, reason, leader.baseline)
    };
    wear.novelty = leader.novelty.clone().map(|novelty| Novelty { outside: true, p_value, ..novelty });
    wear
}

/// Mixes the depth distributions of the estimated channels into the leading channel's estimate. The library's
/// error is common to all of them, so more channels do not narrow an interval, and channels that disagree
/// widen it.
fn mix(latest: &[(&str, &WearEstimate)], wear: &mut WearEstimate) {
    let estimated: Vec<&(&str, &WearEstimate)> =
        latest.iter().filter(|(_, other)| other.status == WearStatus::Estimated).collect();
    let Some(mut mixture) = wear.posterior.clone() else { return };
    let posteriors: Vec<_> = estimated
        .iter()
        .filter_map(|(_, other)| other.posterior.as_ref())
        .filter(|posterior| posterior.wear_um == mixture.wear_um)
        .collect();
    // While histories are recomputed, channels may use another grid than the leading one.
    if posteriors.len() < 2 || posteriors.len() < estimated.len() {
        return;
    }
    let part = 1.0 / posteriors.len() as f64;
    for (point, probability) in mixture.probability.iter_mut().enumerate() {
        *probability =
            posteriors.iter().filter_map(|posterior| posterior.probability.get(point)).sum::<f64>() * part;
    }
    let grid = DepthGrid::of(&mixture.wear_um);
    let quantile = |level| grid.quantile_um(&mixture.probability, level);
    let [least, p25, median, p75] = [0.05, 0.25, 0.5, 0.75].map(quantile);
    let [low, high] = grid.interval_um(&mixture.probability);
    let end_um = mixture.wear_um.last().copied().unwrap_or_default();
    let at_end = high >= grid.cell_um(mixture.wear_um.len().saturating_sub(2))[0];
    let names: Vec<&str> = estimated.iter().map(|(channel, _)| *channel).collect();
    let names = names.join(", ");
    (wear.status, wear.reason) = if high - low > MAX_MIXTURE_PART * end_um {
        let reason = format!("channels {names} disagree: wear between {low:.0} and {high:.0} µm is possible");
        (WearStatus::NotIdentifiable, reason)
    } else if at_end {
        let reason = format!(
            "wear of at least {least:.0} µm with 95 % probability from channels {names}; the library ends at {end_um:.0} µm"
        );
        (WearStatus::Estimated, reason)
    } else {
        let reason = format!(
            "wear {median:.0} µm, between {low:.0} and {high:.0} µm with 90 % probability from channels {names}"
        );
        (WearStatus::Estimated, reason)
    };
    let above: Option<Vec<f64>> = estimated.iter().map(|(_, other)| other.above_limit).collect();
    wear.above_limit = above.map(|above| above.iter().sum::<f64>() * part);
    wear.transmission_error_um =
        hull(estimated.iter().filter_map(|(_, other)| other.transmission_error_um), part);
    wear.mean_um = Some(grid.mean_um(&mixture.probability));
    (wear.low_um, wear.p25_um, wear.median_um) = (Some(low), Some(p25), Some(median));
    (wear.p75_um, wear.high_um) = (Some(p75), Some(high));
    wear.at_least_um = at_end.then_some(least);
    wear.posterior = Some(mixture);
}

/// Returns the interval that contains all of these, with the mean of their medians.
fn hull(intervals: impl Iterator<Item = Interval>, part: f64) -> Option<Interval> {
    let all = intervals.map(|one| Interval { median: part * one.median, ..one });
    all.reduce(|a, b| Interval { median: a.median + b.median, p05: a.p05.min(b.p05), p95: a.p95.max(b.p95) })
}

#[cfg(test)]
mod tests;
