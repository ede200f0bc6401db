//! What is believed of the wear: a probability over depths under each hypothesis, a weight of each, and what is known of the path.

use serde::{Deserialize, Serialize};

use super::depth_grid::DepthGrid;
use super::hypotheses::{Beginning, Compared, Hypotheses};
use super::path_gain::PathGain;
use super::transition::{Growth, RateWeights};

/// Weight of a record's likelihood in the tracking: what is wrong with a library at one depth is wrong in the next records too, so that many
/// records there are not worth as many independent ones.
const LIKELIHOOD_WEIGHT: f64 = 1.0;

/// Weight of the same in telling hypotheses apart, where such errors add up over the whole life.
const EVIDENCE_WEIGHT: f64 = 0.0125;

/// Steps to either side, and reach in standard deviations, of the spread over unknown shapes of wear.
const SHAPE_STEPS: i32 = 48;
const SHAPE_REACH: f64 = 2.5;

/// No hypothesis falls below this logarithm of a weight: it may come back.
const LEAST_LOG_WEIGHT: f64 = -12.0;

/// Probabilities below this part of the highest are not kept.
const LEAST_PART: f64 = 1e-7;

/// Mean distance in µm from the depth at the baseline's end that a hypothesis begins with.
const BEGINNING_SPREAD_UM: f64 = 1.5;

/// Probability over depths from some grid point on; the numbers are single precision so that the state stays small.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Sparse {
    first: usize,
    values: Vec<f32>,
}

/// The state of the tracking.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Belief {
    log_weights: Vec<f64>,
    by_hypothesis: Vec<Sparse>,
    path: PathGain,
    rates: RateWeights,
}

/// What a record did to the belief.
pub(super) struct Updated {
    /// Hypothesis and depth that explain this record best.
    pub(super) best: (usize, usize),
    pub(super) log_evidence: f64,
}

impl Sparse {
    fn of(probability: &[f64]) -> Self {
        let highest = probability.iter().copied().fold(0.0, f64::max);
        let kept = |p: &f64| *p > LEAST_PART * highest;
        let first = probability.iter().position(kept).unwrap_or(0);
        let last = probability.iter().rposition(kept).unwrap_or(0);
        Self {
            first,
            values: probability[first..=last].iter().map(|&p| p as f32).collect(),
        }
    }

    fn dense(&self, probability: &mut [f64]) {
        probability.fill(0.0);
        for (out, value) in probability[self.first..].iter_mut().zip(&self.values) {
            *out = f64::from(*value);
        }
    }
}

impl Belief {
    /// What is believed when the baseline is complete.
    pub(super) fn start(hypotheses: &Hypotheses, grid: &DepthGrid) -> Self {
        let begin = |um: f64| Sparse::of(&grid.around(um, BEGINNING_SPREAD_UM));
        let mut belief = Self {
            log_weights: hypotheses.all.iter().map(|hypothesis| hypothesis.log_weight).collect(),
            by_hypothesis: hypotheses.all.iter().map(|hypothesis| begin(hypothesis.baseline_end_um)).collect(),
            path: hypotheses.path.clone(),
            rates: RateWeights::default(),
        };
        belief.normalise();
        belief
    }

    /// Whether this belief is about these hypotheses.
    pub(super) fn fits(&self, hypotheses: &Hypotheses, grid: &DepthGrid) -> bool {
        let inside = |sparse: &Sparse| sparse.first + sparse.values.len() <= grid.depths_um().len();
        self.by_hypothesis.len() == hypotheses.all.len()
            && self.by_hypothesis.iter().all(inside)
            && self.path.fits(hypotheses.lines(), hypotheses.all.len())
    }

    /// What is known of the path.
    pub(super) fn path(&self) -> &PathGain {
        &self.path
    }

    /// Takes one record, compared by what was known of the path before it.
    pub(super) fn update(&mut self, compared: &Compared, hypotheses: &Hypotheses, grid: &DepthGrid, growth: &Growth) -> Updated {
        let depths = grid.depths_um().len();
        let mut dense = vec![0.0; depths];
        let mut evidence = Vec::with_capacity(self.by_hypothesis.len());
        let mut log_evidence = Vec::with_capacity(self.by_hypothesis.len());
        let mut probability = Vec::with_capacity(self.by_hypothesis.len());
        let before = self.leading();
        self.by_hypothesis[before].dense(&mut dense);
        let of_leading = &compared.log_likelihood[before * depths..(before + 1) * depths];
        let highest = of_leading.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let likelihood: Vec<f64> = of_leading.iter().map(|l| (LIKELIHOOD_WEIGHT * (l - highest)).exp()).collect();
        let mut rates = self.rates;
        growth.learn(&mut rates, &dense, &likelihood);
        for (index, sparse) in self.by_hypothesis.iter_mut().enumerate() {
            let log_likelihood = &compared.log_likelihood[index * depths..(index + 1) * depths];
            sparse.dense(&mut dense);
            let mut advanced = vec![0.0; depths];
            growth.advance(&self.rates, &dense, &mut advanced);
            let highest = log_likelihood.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let (mut explained, mut total) = (0.0, 0.0);
            for (p, l) in advanced.iter_mut().zip(log_likelihood) {
                let likely = (l - highest).exp();
                explained += *p * likely;
                *p *= likely.powf(LIKELIHOOD_WEIGHT);
                total += *p;
            }
            log_evidence.push(explained.max(f64::MIN_POSITIVE).ln() + highest);
            let total = total.max(f64::MIN_POSITIVE);
            evidence.push(total.ln() + LIKELIHOOD_WEIGHT * highest);
            advanced.iter_mut().for_each(|p| *p /= total);
            *sparse = Sparse::of(&advanced);
            probability.push(advanced);
        }
        self.rates = rates;
        let weighted = log_evidence.iter().zip(&self.log_weights).map(|(e, w)| e + w);
        let peak = weighted.clone().fold(f64::NEG_INFINITY, f64::max);
        let sum: f64 = weighted.map(|e| (e - peak).exp()).sum();
        for (weight, evidence) in self.log_weights.iter_mut().zip(evidence) {
            *weight += EVIDENCE_WEIGHT * evidence;
        }
        self.normalise();
        let leading = self.leading();
        let (residuals, variance) = hypotheses.left(compared, &probability, leading);
        self.path.learn(&compared.gain, &residuals, &variance, leading);
        Updated {
            best: compared.best(depths),
            log_evidence: peak + sum.ln(),
        }
    }

    fn leading(&self) -> usize {
        let weight = |&index: &usize| self.log_weights[index];
        (0..self.log_weights.len())
            .max_by(|a, b| weight(a).total_cmp(&weight(b)))
            .unwrap_or(0)
    }

    /// Probability over true depths: that over the tracked ones, spread by what an unknown shape of the wear does.
    /// `deviation` is the standard deviation of the logarithm of true over tracked depth.
    pub(super) fn spread_probability(&self, grid: &DepthGrid, deviation: f64) -> Vec<f64> {
        spread(&self.probability(grid), grid.depths_um(), deviation)
    }

    /// Probability over tracked depths, all hypotheses together.
    pub(super) fn probability(&self, grid: &DepthGrid) -> Vec<f64> {
        let mut total = vec![0.0; grid.depths_um().len()];
        for (sparse, log_weight) in self.by_hypothesis.iter().zip(&self.log_weights) {
            let weight = log_weight.exp();
            for (out, value) in total[sparse.first..].iter_mut().zip(&sparse.values) {
                *out += weight * f64::from(*value);
            }
        }
        let sum: f64 = total.iter().sum();
        total.iter_mut().for_each(|p| *p /= sum);
        total
    }

    /// The likeliest hypothesis and its likeliest depth.
    pub(super) fn likeliest(&self, grid: &DepthGrid) -> (usize, usize) {
        let highest = |values: &mut dyn Iterator<Item = f64>| {
            let start = (0, f64::NEG_INFINITY);
            let best = values
                .enumerate()
                .fold(start, |best, (i, value)| if value > best.1 { (i, value) } else { best });
            best.0
        };
        let hypothesis = highest(&mut self.log_weights.iter().copied());
        let sparse = &self.by_hypothesis[hypothesis];
        let depth = sparse.first + highest(&mut sparse.values.iter().map(|&p| f64::from(p)));
        (hypothesis, depth.min(grid.depths_um().len() - 1))
    }

    /// What a new baseline begins with: quantiles of the depth, and the weight of each member of the ensemble.
    pub(super) fn carried(&self, hypotheses: &Hypotheses, grid: &DepthGrid) -> Beginning {
        let probability = self.probability(grid);
        let depths_um = [0.05, 0.25, 0.5, 0.75, 0.95].map(|level| grid.quantile_um(&probability, level));
        let weights = [0.1, 0.25, 0.3, 0.25, 0.1];
        let mut members = vec![0.0; hypotheses.all.iter().map(|hypothesis| hypothesis.member + 1).max().unwrap_or(0)];
        for (hypothesis, log_weight) in hypotheses.all.iter().zip(&self.log_weights) {
            members[hypothesis.member] += log_weight.exp();
        }
        Beginning {
            depths_um: depths_um.into_iter().zip(weights).collect(),
            members,
        }
    }

    fn normalise(&mut self) {
        let peak = self.log_weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let sum: f64 = self.log_weights.iter().map(|weight| (weight - peak).exp()).sum();
        for weight in &mut self.log_weights {
            *weight = (*weight - peak - sum.ln()).max(LEAST_LOG_WEIGHT);
        }
    }
}

/// A log-normal factor on each depth; what would lie beyond the grid stays at its end.
fn spread(probability: &[f64], depths_um: &[f64], deviation: f64) -> Vec<f64> {
    let factors: Vec<(f64, f64)> = (-SHAPE_STEPS..=SHAPE_STEPS)
        .map(|step| {
            let z = SHAPE_REACH * f64::from(step) / f64::from(SHAPE_STEPS);
            ((deviation * z).exp(), (-0.5 * z * z).exp())
        })
        .collect();
    let total: f64 = factors.iter().map(|(_, weight)| weight).sum();
    let mut spread = vec![0.0; probability.len()];
    for (um, p) in depths_um.iter().zip(probability).filter(|(_, p)| **p > 1e-9) {
        for (factor, weight) in &factors {
            let mass = p * weight / total;
            let upper = depths_um.partition_point(|depth| *depth <= um * factor);
            if upper == depths_um.len() {
                spread[upper - 1] += mass;
                continue;
            }
            let part = (um * factor - depths_um[upper - 1]) / (depths_um[upper] - depths_um[upper - 1]);
            spread[upper - 1] += mass * (1.0 - part);
            spread[upper] += mass * part;
        }
    }
    let kept: f64 = spread.iter().sum();
    spread.iter_mut().for_each(|p| *p /= kept);
    spread
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sure_depth_becomes_log_normal_and_no_wear_stays_no_wear() {
        let depths: Vec<f64> = (0..2001).map(f64::from).collect();
        let mut sure = vec![0.0; 2001];
        sure[1000] = 1.0;
        let spread_out = spread(&sure, &depths, 0.2);
        let log_moment = |power: i32| -> f64 {
            let terms = spread_out.iter().enumerate().skip(1);
            terms.map(|(i, p)| p * (i as f64 / 1000.0).ln().powi(power)).sum()
        };
        // A normal distribution cut at ± 2.5 deviations keeps 91 % of its variance; the sum with full ends keeps a little more.
        assert!(log_moment(1).abs() < 1e-3);
        let part = log_moment(2) / (0.2 * 0.2);
        assert!((part - 0.94).abs() < 0.04, "{part}");
        let mut none = vec![0.0; 10];
        none[0] = 1.0;
        assert!((spread(&none, &depths[..10], 0.2)[0] - 1.0).abs() < 1e-12);
    }

    #[test]
    fn sparse_is_dense_without_what_does_not_matter() {
        let probability = [0.0, 1e-12, 0.25, 0.5, 0.25, 0.0];
        let sparse = Sparse::of(&probability);
        assert_eq!((sparse.first, sparse.values.len()), (2, 3));
        let mut dense = [1.0; 6];
        sparse.dense(&mut dense);
        assert_eq!(dense, [0.0, 0.0, 0.25, 0.5, 0.25, 0.0]);
    }
}
