//! Benchmark of libraries of random pairs against that of the pair of Shen et al. 2022 by the same contact
//! rule, in processor time.
//!
//! `cargo bench -p flankwatch-wear --bench pairs` draws 48 pairs; `FLANKWATCH_PAIRS=70` draws 70. A library
//! has 50 states and one operating point. The reference is measured before and after each library, and a
//! ratio is the median of three, since the clock of a shared machine wanders.

use std::fs;

use flankwatch_gear::{ContactRule, PairSpec};
use flankwatch_wear::library::{self, BuildControl, GridSettings};

#[path = "../tests/any_pair/plausible.rs"]
mod plausible;

const PAIR: &str = include_str!("../../../fixtures/pairs/shen2022.toml");
const PAIRS: u64 = 48;
const REPEATS: usize = 3;
/// Clock ticks per second in `/proc/self/stat`.
const TICKS_PER_SECOND: f64 = 100.0;

fn main() {
    let pairs = std::env::var("FLANKWATCH_PAIRS")
        .map_or(PAIRS, |pairs| pairs.parse().expect("FLANKWATCH_PAIRS is a number"));
    let mut greatest = [0.0_f64; 2];
    let drawn = (0..pairs).map(|number| (number, plausible::pair(number)));
    for (number, spec) in drawn.filter(|(_, spec)| spec.check().is_ok()) {
        let rule = spec.dynamics.contact;
        let mut reference = PairSpec::from_toml(PAIR).expect("the fixture is a pair file");
        reference.dynamics.contact = rule;
        let mut ratios: Vec<f64> = (0..REPEATS).map(|_| ratio(&spec, &reference)).collect();
        ratios.sort_by(f64::total_cmp);
        let ratio = ratios[REPEATS / 2];
        println!("pair {number}, {rule}: {ratio:.2} times");
        let of_rule = &mut greatest[usize::from(rule == ContactRule::Loaded)];
        *of_rule = of_rule.max(ratio);
    }
    println!("at most {:.2} times (threshold), {:.2} times (loaded)", greatest[0], greatest[1]);
}

fn ratio(spec: &PairSpec, reference: &PairSpec) -> f64 {
    let before = processor_s(reference);
    let library = processor_s(spec);
    2.0 * library / (before + processor_s(reference))
}

/// Processor time of a library in seconds.
fn processor_s(spec: &PairSpec) -> f64 {
    let before = used_s();
    let grid = GridSettings::default().for_pair(spec);
    library::build(spec, &grid, &BuildControl::silent()).expect("an accepted pair has a library");
    used_s() - before
}

/// Processor time of this process in seconds.
fn used_s() -> f64 {
    let text = fs::read_to_string("/proc/self/stat").expect("Linux shows the processor time");
    let fields: Vec<&str> = text.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    [11, 12].iter().map(|n| fields[*n].parse::<f64>().expect("a number of ticks") / TICKS_PER_SECOND).sum()
}
