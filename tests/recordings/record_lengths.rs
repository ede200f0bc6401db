//! A healthy gearbox with records of any length and rate.

use std::sync::Arc;

use flankwatch::estimate::{WearEstimate, WearStatus};

use crate::wear_estimates::{
    GEARBOX_BASELINE, GEARBOX_RATE_HZ, PIECE, channels, ensemble, estimate, gearbox, mesh, pieces, pieces_at,
};
use flankwatch_test_support::recordings;

/// Returns how many estimates have a depth and how many are not comparable; fails on any other status.
fn shares(answers: &[WearEstimate], what: &str) -> [usize; 2] {
    let mut shares = [0; 2];
    for answer in answers {
        match answer.status {
            WearStatus::Estimated => shares[0] += 1,
            WearStatus::NotComparable => shares[1] += 1,
            _ => panic!("{what}: {}", answer.reason),
        }
    }
    shares
}

/// The healthy gearbox with a baseline of 0.4 s pieces, and the rest of the same recording cut at other
/// lengths or resampled: no piece is flagged. 0.1 s are three turns, too few to tell the mesh lines from
/// their sidebands.
#[test]
#[ignore = "needs the folder of real recordings"]
fn a_healthy_gearbox_is_not_flagged_at_any_record_length() {
    let folder = recordings("gearbox-spectraquest");
    let pair = gearbox();
    let (ensemble, mesh) = (ensemble(&pair, 110.0, GEARBOX_RATE_HZ), mesh(&pair));
    let cuts = [0.1, 0.2, 0.4, 1.0, 2.0, 5.0].map(|seconds| (seconds, 1.0)).into_iter();
    for (seconds, factor) in cuts.chain([(0.4, 0.5), (0.4, 2.0), (2.0, 0.5), (2.0, 2.0)]) {
        let mut all = [0; 2];
        for load in ["0", "50", "90"] {
            for (channel, samples) in channels(&folder, &format!("h30hz{load}")).iter().enumerate() {
                let (first, rest) = samples.split_at(GEARBOX_BASELINE * PIECE);
                // The rest is shorter than 5 s.
                let rest = if seconds > 2.0 { samples } else { rest };
                let (rest, rate_hz) = (resampled(rest, factor), factor * GEARBOX_RATE_HZ);
                let others = pieces_at(&rest, (seconds * rate_hz) as usize, &mesh, rate_hz);
                let records = pieces(first, PIECE, &mesh).into_iter().chain(others);
                let answers = estimate(GEARBOX_BASELINE, Some(Arc::clone(&ensemble)), records);
                let what = format!("load {load}, a{}, {seconds} s at {rate_hz} Hz", channel + 1);
                let of_these = shares(&answers[GEARBOX_BASELINE..], &what);
                all = [all[0] + of_these[0], all[1] + of_these[1]];
            }
        }
        let [estimated, not_comparable] = all;
        eprintln!("{seconds} s, rate × {factor}: {estimated} estimated, {not_comparable} not comparable");
        let wanted = if seconds < 0.15 { estimated } else { not_comparable };
        assert!(wanted == 0 && estimated + not_comparable > 0, "{seconds} s, rate × {factor}: {all:?}");
    }
}

/// The baseline has pieces of 0.1, 0.4, 1 and 0.2 s in turn.
#[test]
#[ignore = "needs the folder of real recordings"]
fn a_baseline_may_have_records_of_different_lengths() {
    let folder = recordings("gearbox-spectraquest");
    let pair = gearbox();
    let (ensemble, mesh) = (ensemble(&pair, 110.0, GEARBOX_RATE_HZ), mesh(&pair));
    let (mut judged, mut without_line) = ([0; 2], 0);
    for load in ["0", "50", "90"] {
        for (channel, samples) in channels(&folder, &format!("h30hz{load}")).iter().enumerate() {
            let mut lengths =
                [0.1, 0.4, 1.0, 0.2].map(|s| (s * GEARBOX_RATE_HZ) as usize).into_iter().cycle();
            let mut rest = &samples[..];
            let records = std::iter::from_fn(|| {
                let (piece, after) = rest.split_at_checked(lengths.next()?)?;
                rest = after;
                pieces(piece, piece.len(), &mesh).pop()
            });
            let mut answers = estimate(8, Some(Arc::clone(&ensemble)), records);
            answers.retain(|answer| answer.status != WearStatus::CollectingBaseline);
            let count = answers.len();
            answers.retain(|answer| answer.status != WearStatus::NoFeatures);
            without_line += count - answers.len();
            let of_these = shares(&answers, &format!("load {load}, a{}", channel + 1));
            judged = [judged[0] + of_these[0], judged[1] + of_these[1]];
        }
    }
    eprintln!("{judged:?} estimated and not comparable, {without_line} without a mesh line");
    assert!(judged[0] > 60 && without_line <= 2, "{judged:?} {without_line}");
}

/// Every other sample of a low-pass, or a sample between each two: sums over 64 samples of a sinc under a
/// Blackman window.
fn resampled(samples: &[f32], factor: f64) -> Vec<f32> {
    const REACH: i64 = 64;
    let count = (samples.len() as f64 * factor) as usize;
    let cut = factor.min(1.0);
    let value = |n: usize| {
        let at = n as f64 / factor;
        let first = at.floor() as i64 - REACH + 1;
        (first..first + 2 * REACH)
            .filter_map(|k| {
                let sample = f64::from(*samples.get(usize::try_from(k).ok()?)?);
                let t = at - k as f64;
                let x = std::f64::consts::PI * t;
                let sinc = if t == 0.0 { cut } else { (cut * x).sin() / x };
                let w = x / REACH as f64;
                Some(sample * sinc * (0.42 + 0.5 * w.cos() + 0.08 * (2.0 * w).cos()))
            })
            .sum::<f64>() as f32
    };
    (0..count).map(value).collect()
}
