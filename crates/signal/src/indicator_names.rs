//! Which indicators there are, and which of them a misspelt name is near to.

use super::band::Band;
use super::gear_indicators;
use super::indicators::Indicators;
use crate::AnalysisSettings;

/// Those of the record as it is, besides the lines and bands.
const OF_THE_RECORD: [&str; 5] = ["rms", "peak", "crest_factor", "kurtosis", "omx"];

/// Those that need the records before.
const OF_THE_RUN: [&str; 3] = ["na4", "nb4", "novelty"];

/// How many names are told in place of one that there is not.
const NEAREST: usize = 3;

impl Indicators {
    /// The names of all indicators there can be; `bands` are those that the user defined.
    pub fn names(bands: &[Band]) -> Vec<String> {
        let harmonics = AnalysisSettings::default().harmonics;
        let fixed = OF_THE_RECORD.into_iter().chain(gear_indicators::NAMES).chain(OF_THE_RUN);
        let lines = (1..=harmonics).map(|order| format!("mesh_{order}"));
        fixed.map(str::to_owned).chain(lines).chain(bands.iter().map(Band::indicator)).collect()
    }

    /// The names nearest to one, the nearest first; of equally near ones in the order given.
    pub fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Vec<&'a str> {
        let name = name.to_lowercase();
        let mut far: Vec<(usize, &str)> =
            known.into_iter().map(|known| (edits(&name, known), known)).collect();
        far.sort_by_key(|(edits, _)| *edits);
        far.into_iter().take(NEAREST).map(|(_, known)| known).collect()
    }
}

/// Letters to insert, delete, replace, or exchange with the one beside (Damerau 1964, optimal string
/// alignment).
fn edits(from: &str, to: &str) -> usize {
    // Longer than any name; the cost grows with the product of both lengths.
    let from: Vec<char> = from.chars().take(64).collect();
    let to: Vec<char> = to.chars().collect();
    let mut rows: Vec<Vec<usize>> = vec![(0..=to.len()).collect()];
    for i in 1..=from.len() {
        let mut row = vec![i];
        for j in 1..=to.len() {
            let is_other = usize::from(from[i - 1] != to[j - 1]);
            let mut least = (rows[i - 1][j] + 1).min(row[j - 1] + 1).min(rows[i - 1][j - 1] + is_other);
            if i > 1 && j > 1 && from[i - 1] == to[j - 2] && from[i - 2] == to[j - 1] {
                least = least.min(rows[i - 2][j - 2] + 1);
            }
            row.push(least);
        }
        rows.push(row);
    }
    rows[from.len()][to.len()]
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use jiff::Timestamp;

    use super::*;
    use crate::{Analyzer, BandQuantity, ConditionSettings, MeshContext, Record, RunMeans};

    #[test]
    fn the_names_are_those_that_an_analysis_gives() {
        let bands = [Band { name: "low".into(), band_hz: [10.0, 100.0], quantity: BandQuantity::Record }];
        let samples = (0..2000).map(|k| (0.3 * f64::from(k)).sin() as f32).collect();
        let record = Record::new("a", Timestamp::UNIX_EPOCH, 1000.0, "m/s2", samples).unwrap();
        let settings =
            ConditionSettings { mesh: MeshContext::unknown(), bands: &bands, gear_indicators: true };
        let mut analysed =
            Analyzer::new(AnalysisSettings::default()).condition(&record, &settings).analysis.indicators;
        analysed.extend(RunMeans::default().update(&analysed));
        let given: BTreeSet<&str> =
            analysed.values.keys().chain(analysed.absent.keys()).map(String::as_str).collect();
        let names = Indicators::names(&bands);
        // That of the estimate comes after a baseline only.
        let told: BTreeSet<&str> =
            names.iter().map(String::as_str).filter(|name| *name != "novelty").collect();
        assert_eq!(told, given);
        assert_eq!(names.len(), told.len() + 1, "each once");
    }

    #[test]
    fn the_nearest_names_come_first() {
        let names = Indicators::names(&[]);
        let nearest = |name: &str| Indicators::nearest(name, names.iter().map(String::as_str));
        assert_eq!(nearest("kurtsosis")[0], "kurtosis");
        assert_eq!(nearest("RMS")[0], "rms");
        assert_eq!(nearest("mehs_2")[0], "mesh_2");
        assert_eq!(nearest(&"x".repeat(100_000)).len(), 3);
        assert_eq!((edits("abc", "acb"), edits("", "ab"), edits("rms", "rms")), (1, 2, 0));
    }
}
