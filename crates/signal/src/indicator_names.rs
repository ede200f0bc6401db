//! The names of all indicators, and suggestions for a misspelt one.

use super::band::Band;
use super::bearing::Bearing;
use super::gear_indicators;
use super::indicators::Indicators;
use super::velocity::VELOCITY_RMS;
use crate::AnalysisSettings;

/// Indicators of the record itself, besides mesh lines and bands.
const RECORD_INDICATORS: [&str; 5] = ["rms", "peak", "crest_factor", "kurtosis", VELOCITY_RMS];

/// The run indicator that needs no mesh.
const NOVELTY: &str = "novelty";

/// Mesh indicators that depend on earlier records.
const RUN_INDICATORS: [&str; 2] = ["na4", "nb4"];

/// Number of names suggested for an unknown one.
const MAX_SUGGESTIONS: usize = 3;

/// The parts of a machine's configuration that determine its set of indicators.
#[derive(Debug, Clone, Copy)]
pub struct IndicatorScope<'a> {
    /// User-defined bands.
    pub bands: &'a [Band],
    /// The bearings.
    pub bearings: &'a [Bearing],
    /// Whether there is a gear mesh.
    pub has_mesh: bool,
}

impl Default for IndicatorScope<'_> {
    /// A mesh without bands or bearings.
    fn default() -> Self {
        Self { bands: &[], bearings: &[], has_mesh: true }
    }
}

impl Indicators {
    /// Returns the names of all possible indicators within `scope`.
    pub fn names(scope: &IndicatorScope<'_>) -> Vec<String> {
        let harmonics = if scope.has_mesh { AnalysisSettings::default().harmonics } else { 0 };
        let of_mesh = ["omx"].into_iter().chain(gear_indicators::NAMES).chain(RUN_INDICATORS);
        let of_mesh = of_mesh.filter(|_| scope.has_mesh);
        let fixed = RECORD_INDICATORS.into_iter().chain(of_mesh).chain([NOVELTY]);
        let lines = (1..=harmonics).map(|order| format!("mesh_{order}"));
        let of_bearings = scope.bearings.iter().flat_map(Bearing::all_indicators);
        let of_bands = scope.bands.iter().map(Band::indicator);
        fixed.map(str::to_owned).chain(lines).chain(of_bearings).chain(of_bands).collect()
    }

    /// Returns the known names with the fewest edits from `name`, nearest first; ties keep the given order.
    pub fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Vec<&'a str> {
        let name = name.to_lowercase();
        let mut by_distance: Vec<(usize, &str)> =
            known.into_iter().map(|known| (edits(&name, known), known)).collect();
        by_distance.sort_by_key(|(edits, _)| *edits);
        by_distance.into_iter().take(MAX_SUGGESTIONS).map(|(_, known)| known).collect()
    }
}

/// Returns the edit distance: letters to insert, delete, replace, or swap with a neighbour (Damerau 1964,
/// optimal string alignment).
fn edits(from: &str, to: &str) -> usize {
    // No name is longer. The cost grows with the product of both lengths.
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
    use crate::{
        Analyzer, BandQuantity, BearingOrders, BearingSettings, ConditionSettings, MeshContext, Name, Record,
        RunMeans,
    };

    fn given(mesh: MeshContext, bands: &[Band], bearings: &[Bearing]) -> BTreeSet<String> {
        let samples = (0..2000).map(|k| (0.3 * f64::from(k)).sin() as f32).collect();
        let record = Record::new("a", Timestamp::UNIX_EPOCH, 1000.0, "m/s2", samples).unwrap();
        let bearings = BearingSettings { bearings, ..BearingSettings::default() };
        let settings = ConditionSettings { mesh, bands, gear_indicators: true, bearings };
        let mut analysed =
            Analyzer::new(AnalysisSettings::default()).condition(&record, &settings).analysis.indicators;
        if mesh.teeth > 0 {
            analysed.extend(RunMeans::default().update(&analysed));
        }
        analysed.values.keys().chain(analysed.absent.keys()).map(Name::to_string).collect()
    }

    #[test]
    fn the_names_match_an_analysis() {
        let bands = [Band { name: "low".into(), band_hz: [10.0, 100.0], quantity: BandQuantity::Record }];
        let orders = BearingOrders::of_geometry(9, 0.2, 0.0);
        let bearings = [Bearing { name: "de".into(), shaft_turns: 1.0, orders }];
        let mesh = MeshContext { teeth: 20, nominal_shaft_speed_hz: 2.0, ..MeshContext::unknown() };
        for (mesh, has_mesh) in [(mesh, true), (MeshContext::unknown(), false)] {
            let names = Indicators::names(&IndicatorScope { bands: &bands, bearings: &bearings, has_mesh });
            // That of the estimate comes after a baseline only.
            let told: BTreeSet<String> = names.iter().filter(|name| *name != NOVELTY).cloned().collect();
            assert_eq!(told, given(mesh, &bands, &bearings));
            assert_eq!(names.len(), told.len() + 1, "each once");
        }
    }

    #[test]
    fn the_nearest_names_come_first() {
        let names = Indicators::names(&IndicatorScope::default());
        let nearest = |name: &str| Indicators::nearest(name, names.iter().map(String::as_str));
        assert_eq!(nearest("kurtsosis")[0], "kurtosis");
        assert_eq!(nearest("RMS")[0], "rms");
        assert_eq!(nearest("mehs_2")[0], "mesh_2");
        assert_eq!(nearest(&"x".repeat(100_000)).len(), 3);
        assert_eq!((edits("abc", "acb"), edits("", "ab"), edits("rms", "rms")), (1, 2, 0));
    }
}
