//! One answer from all channels of a mesh.
//!
//! It follows from the latest estimates of the channels alone, so it is the same whatever the order in which
//! their records came. Each channel's novelty already pools its own records (`cusum`); here the channels'
//! evidence is pooled, and the depths of those that wear explains are mixed.

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};

use super::depth_grid::DepthGrid;
use super::deviation::normal_tail;
use super::novelty::{MIN_P_VALUE, Novelty};
use super::wear::{Interval, WearEstimate, WearStatus};

/// Correlation that is assumed between what channels of one machine deviate by: load and temperature move
/// them together.
const CORRELATION: f64 = 0.7;

/// From this p-value on a channel is named as one that contributes.
const CONTRIBUTING_P_VALUE: f64 = 0.05;

/// A channel is silent where it has missed so many of its records while another one went on.
const MAX_MISSED_RECORDS: i32 = 10;

/// A mixture wider than this part of the library says that the channels do not tell.
const MAX_MIXTURE_PART: f64 = 0.6;

/// What one channel adds to the asset's answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ChannelContribution {
    /// The channel.
    pub channel: String,
    /// What kind of answer its latest record has.
    pub status: WearStatus,
    /// The same in words.
    pub reason: String,
    /// −log₁₀ of the probability that a healthy channel deviates as much; none where it was not judged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub novelty_score: Option<f64>,
    /// Its own median wear depth in µm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub median_um: Option<f64>,
    /// Its own 5 % quantile in µm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p05_um: Option<f64>,
    /// Its own 95 % quantile in µm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p95_um: Option<f64>,
    /// Start of its latest record, where it is silent and so takes no part in the answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub silent_since: Option<Timestamp>,
}

/// When a channel's records began.
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
    /// Mean time from one record to the next; none of a single record.
    fn interval(&self) -> Option<SignedDuration> {
        let intervals = i32::try_from(self.count).unwrap_or(i32::MAX) - 1;
        (intervals > 0).then(|| self.latest.duration_since(self.first) / intervals)
    }

    /// Whether this channel has ended while others went on: `newest` is the latest record of them all. A
    /// channel with a single record is measured by the `usual` interval.
    fn is_silent(&self, newest: Timestamp, usual: SignedDuration) -> bool {
        newest.duration_since(self.latest) > self.interval().unwrap_or(usual) * MAX_MISSED_RECORDS
    }

    /// Which of an asset's channels are silent. Never all of them: the one with the newest record is not.
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

/// The answer of an asset.
#[derive(Debug, Clone, PartialEq)]
pub struct JointEstimate {
    /// Which of the channels says most, by its place among them.
    pub leading: usize,
    /// The one answer.
    pub wear: WearEstimate,
    /// What each channel adds, in their order.
    pub channels: Vec<ChannelContribution>,
}

impl JointEstimate {
    /// Joins the latest estimates of an asset's channels; none where there is no channel. Of several that say
    /// as much the first one leads.
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
        // A part of the library leaves open what its rest may explain.
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
            // A channel that stands out by itself is not made less certain by those that hear nothing.
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

    /// Names a channel that took no part, since it is silent.
    pub fn add_silent_channel(&mut self, channel: &str, wear: &WearEstimate, since: Timestamp) {
        self.wear.reason =
            format!("{}; channel {channel} takes no part: no record since {since:.0}", self.wear.reason);
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
            p05_um: wear.p05_um,
            p95_um: wear.p95_um,
            silent_since: None,
        }
    }
}

/// How much a channel's latest estimate has to say about the machine.
fn priority(status: WearStatus) -> u8 {
    match status {
        WearStatus::OutsideLibrary => 4,
        WearStatus::Estimated => 3,
        WearStatus::NotIdentifiable | WearStatus::Provisional => 2,
        WearStatus::SensorFault => 1,
        _ => 0,
    }
}

/// Of several that are outside the library the one that is so with the most certainty, else the first.
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

/// The channel whose novelty is highest.
fn most_novel(latest: &[(&str, &WearEstimate)]) -> Option<usize> {
    let scores = latest.iter().enumerate().filter_map(|(n, (_, wear))| Some((n, judged(wear)?)));
    scores.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(n, _)| n)
}

/// The p-value of a channel's novelty, where the record was judged and its sensor is sound.
fn judged(wear: &WearEstimate) -> Option<f64> {
    let novelty = wear.novelty.as_ref().filter(|novelty| novelty.sensor_fault.is_none())?;
    Some(novelty.p_value)
}

/// The p-value of channels together: the smaller of that of the most deviating one, times their number, and
/// that of the sum of normal deviates (Stouffer 1949) with the variance that their correlation gives; twice
/// the smaller, as it is one of two. None for no channel.
fn pooled_p_value(p_values: impl Iterator<Item = f64>) -> Option<f64> {
    let (mut count, mut least, mut sum) = (0.0, 1.0_f64, 0.0);
    for p in p_values {
        count += 1.0;
        least = least.min(p);
        // One that deviates less than the median is no evidence against the others.
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

/// The normal deviate whose upper tail is `p`, from 0 (p of ½ and above) to 12.
fn normal_deviate(p: f64) -> f64 {
    let (mut low, mut high) = (0.0, 12.0);
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if normal_tail(middle) > p { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// The answer where no channel stands out by itself, and all of them together do.
fn jointly_outside(latest: &[(&str, &WearEstimate)], leading: usize, p_value: f64) -> WearEstimate {
    let leader = latest[leading].1;
    let part = |(channel, wear): &(&str, &WearEstimate)| {
        let p = judged(wear).filter(|p| *p < CONTRIBUTING_P_VALUE)?;
        Some(format!("{channel} (novelty {:.1})", Novelty::score_of(p)))
    };
    let parts: Vec<String> = latest.iter().filter_map(part).collect();
    let what = match leader.library_id {
        Some(_) => "no wear explains the channels together",
        None => "the channels together are unlike the healthy ones",
    };
    let reason = format!("{what}, though none of them stands out alone: {}", parts.join(", "));
    let mut wear = WearEstimate {
        library_id: leader.library_id.clone(),
        ensemble_id: leader.ensemble_id.clone(),
        ..WearEstimate::without_number(WearStatus::OutsideLibrary, reason, leader.baseline)
    };
    wear.novelty = leader.novelty.clone().map(|novelty| Novelty { outside: true, p_value, ..novelty });
    wear
}

/// Mixes the depths of the channels that have one into the leader's answer. What is wrong with the library is
/// wrong for all of them, so more channels do not narrow an interval, and channels that disagree widen it.
fn mix(latest: &[(&str, &WearEstimate)], wear: &mut WearEstimate) {
    let estimated: Vec<&(&str, &WearEstimate)> =
        latest.iter().filter(|(_, other)| other.status == WearStatus::Estimated).collect();
    let Some(mut mixture) = wear.posterior.clone() else { return };
    let posteriors: Vec<_> = estimated
        .iter()
        .filter_map(|(_, other)| other.posterior.as_ref())
        .filter(|posterior| posterior.wear_um == mixture.wear_um)
        .collect();
    // Histories that are just made again may stand on another grid than the leader's.
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
    let [p05, p25, median, p75, p95] = [0.05, 0.25, 0.5, 0.75, 0.95].map(quantile);
    let end_um = mixture.wear_um.last().copied().unwrap_or_default();
    let at_end = p95 >= grid.cell_um(mixture.wear_um.len().saturating_sub(2))[0];
    let names: Vec<&str> = estimated.iter().map(|(channel, _)| *channel).collect();
    let names = names.join(", ");
    (wear.status, wear.reason) = if p95 - p05 > MAX_MIXTURE_PART * end_um {
        let reason = format!("channels {names} disagree: wear anywhere between {p05:.0} and {p95:.0} µm");
        (WearStatus::NotIdentifiable, reason)
    } else if at_end {
        let reason = format!(
            "wear of at least {p05:.0} µm with 95 % probability by channels {names}; the library ends at {end_um:.0} µm"
        );
        (WearStatus::Estimated, reason)
    } else {
        let reason = format!(
            "wear {median:.0} µm, between {p05:.0} and {p95:.0} µm with 90 % probability by channels {names}"
        );
        (WearStatus::Estimated, reason)
    };
    let above: Option<Vec<f64>> = estimated.iter().map(|(_, other)| other.above_limit).collect();
    wear.above_limit = above.map(|above| above.iter().sum::<f64>() * part);
    wear.transmission_error_um =
        hull(estimated.iter().filter_map(|(_, other)| other.transmission_error_um), part);
    wear.mean_um = Some(grid.mean_um(&mixture.probability));
    (wear.p05_um, wear.p25_um, wear.median_um) = (Some(p05), Some(p25), Some(median));
    (wear.p75_um, wear.p95_um) = (Some(p75), Some(p95));
    wear.at_least_um = at_end.then_some(p05);
    wear.posterior = Some(mixture);
}

/// The interval that holds all of these, around the mean of their medians.
fn hull(intervals: impl Iterator<Item = Interval>, part: f64) -> Option<Interval> {
    let all = intervals.map(|one| Interval { median: part * one.median, ..one });
    all.reduce(|a, b| Interval { median: a.median + b.median, p05: a.p05.min(b.p05), p95: a.p95.max(b.p95) })
}

#[cfg(test)]
mod tests;
