//! Wear depths from a table, interpolated by a monotone cubic.

use serde::Deserialize;

use super::{GearError, WearPoint};

/// A radius at an end of the tooth may be rounded.
const ROUNDING_MM: f64 = 1e-3;

/// Largest number of lines in a table.
const MAX_POINTS: usize = 10_000;

/// Depth over radius through given points: the piecewise cubic of Fritsch and Carlson (SIAM J. Numer. Anal.
/// 17, 1980) with the three-point slopes of Fritsch and Butland, so depth and slope are continuous and no
/// depth lies outside its neighbours'. Constant beyond the ends, where the slope is zero.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct DepthCurve {
    radii_mm: Vec<f64>,
    depths_mm: Vec<f64>,
    slopes: Vec<f64>,
}

impl DepthCurve {
    /// Interpolates points of ascending radius. No points mean no wear, one point a constant depth.
    pub(super) fn new(points: &[(f64, f64)]) -> Self {
        let (radii_mm, depths_mm): (Vec<f64>, Vec<f64>) = points.iter().copied().unzip();
        let slopes = (0..points.len()).map(|i| knot_slope(points, i)).collect();
        Self { radii_mm, depths_mm, slopes }
    }

    pub(super) fn radii_mm(&self) -> &[f64] {
        &self.radii_mm
    }

    pub(super) fn deepest_mm(&self) -> f64 {
        self.depths_mm.iter().copied().fold(0.0, f64::max)
    }

    /// Depth in mm and its slope over the radius, from the same polynomial.
    pub(super) fn depth_and_slope(&self, radius_mm: f64) -> (f64, f64) {
        let after = self.radii_mm.partition_point(|r| *r <= radius_mm);
        if after == 0 {
            return (self.depths_mm.first().copied().unwrap_or(0.0), 0.0);
        }
        if after == self.radii_mm.len() {
            return (self.depths_mm[after - 1], 0.0);
        }
        let before = after - 1;
        let width = self.radii_mm[after] - self.radii_mm[before];
        let t = (radius_mm - self.radii_mm[before]) / width;
        let (start, rise) = (self.depths_mm[before], self.depths_mm[after] - self.depths_mm[before]);
        let (m0, m1) = (self.slopes[before] * width, self.slopes[after] * width);
        // Hermite's cubic in the powers of t.
        let (c2, c3) = (3.0 * rise - 2.0 * m0 - m1, m0 + m1 - 2.0 * rise);
        let depth = start + t * (m0 + t * (c2 + t * c3));
        let slope = (m0 + t * (2.0 * c2 + 3.0 * t * c3)) / width;
        (depth, slope)
    }
}

/// Returns the slope at knot `i`: zero at the ends, where a constant depth follows, and at an extremum; else
/// the weighted harmonic mean of the two chords.
fn knot_slope(points: &[(f64, f64)], i: usize) -> f64 {
    if i == 0 || i + 1 == points.len() {
        return 0.0;
    }
    let widths = [points[i].0 - points[i - 1].0, points[i + 1].0 - points[i].0];
    let chords = [(points[i].1 - points[i - 1].1) / widths[0], (points[i + 1].1 - points[i].1) / widths[1]];
    if chords[0] * chords[1] <= 0.0 {
        return 0.0;
    }
    let weights = [2.0 * widths[1] + widths[0], widths[1] + 2.0 * widths[0]];
    (weights[0] + weights[1]) / (weights[0] / chords[0] + weights[1] / chords[1])
}

/// Reads the inline table of a pair file, scaled so that its greatest depth is `h_max_mm`.
pub(super) fn from_points(table: &[WearPoint], h_max_mm: f64) -> Result<[DepthCurve; 2], GearError> {
    if table.len() > MAX_POINTS {
        return Err(GearError::field(
            "wear.table",
            format!("{} points", table.len()),
            format!("at most {MAX_POINTS}"),
        ));
    }
    let mut points = [Vec::new(), Vec::new()];
    for point in table {
        if !(1..=2).contains(&point.gear) {
            return Err(GearError::field("wear.table.gear", point.gear, "1 or 2"));
        }
        if !(point.radius_mm > 0.0 && point.radius_mm.is_finite()) {
            return Err(GearError::field("wear.table.radius_mm", point.radius_mm, "a number above 0"));
        }
        if !(point.depth_um >= 0.0 && point.depth_um.is_finite()) {
            return Err(GearError::field("wear.table.depth_um", point.depth_um, "a number of at least 0"));
        }
        points[point.gear as usize - 1].push((point.radius_mm, point.depth_um));
    }
    let greatest_um = table.iter().map(|point| point.depth_um).fold(0.0, f64::max);
    if greatest_um <= 0.0 {
        return Err(GearError::field(
            "wear.table",
            format!("{} points", table.len()),
            "at least one depth above 0 for the shape `table`",
        ));
    }
    for points in &mut points {
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        if let Some(twice) = points.windows(2).find(|two| two[0].0 == two[1].0) {
            return Err(GearError::field("wear.table.radius_mm", twice[0].0, "each radius of a gear once"));
        }
        for point in points.iter_mut() {
            point.1 *= h_max_mm / greatest_um;
        }
    }
    Ok(points.map(|points| DepthCurve::new(&points)))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TextRow {
    gear: String,
    radius_mm: String,
    depth_um: String,
}

/// Reads a table in CSV without scaling the depths. `radii_mm` are the root and tip radii of both gears.
pub(super) fn from_csv(text: &str, radii_mm: [[f64; 2]; 2]) -> Result<[DepthCurve; 2], GearError> {
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_bytes());
    let headers = reader.headers()?.clone();
    if headers.iter().collect::<Vec<_>>() != ["gear", "radius_mm", "depth_um"] {
        let value = headers.iter().collect::<Vec<_>>().join(",");
        return Err(row_error(1, "header", value, "gear,radius_mm,depth_um"));
    }
    let mut points: [Vec<(f64, f64, u64)>; 2] = [Vec::new(), Vec::new()];
    let mut record = csv::StringRecord::new();
    while reader.read_record(&mut record)? {
        let line = record.position().map_or(0, csv::Position::line);
        let row: TextRow = record.deserialize(Some(&headers))?;
        let gear = match row.gear.as_str() {
            "1" => 0,
            "2" => 1,
            _ => return Err(row_error(line, "gear", row.gear, "1 or 2")),
        };
        let [root_mm, tip_mm] = radii_mm[gear];
        let radius_mm = match row.radius_mm.parse::<f64>() {
            Ok(radius) if (root_mm - ROUNDING_MM..=tip_mm + ROUNDING_MM).contains(&radius) => radius,
            _ => {
                return Err(row_error(
                    line,
                    "radius_mm",
                    row.radius_mm,
                    &format!(
                        "a number from {root_mm:.4}, the root radius, to {tip_mm:.4}, the tip radius (mm)"
                    ),
                ));
            }
        };
        let depth_um = match row.depth_um.parse::<f64>() {
            Ok(depth) if depth >= 0.0 && depth.is_finite() => depth,
            _ => return Err(row_error(line, "depth_um", row.depth_um, "a number of at least 0 (µm)")),
        };
        points[gear].push((radius_mm, depth_um * 1e-3, line));
        if points[gear].len() > MAX_POINTS {
            return Err(row_error(line, "gear", row.gear, &format!("at most {MAX_POINTS} lines per gear")));
        }
    }
    if points.iter().all(Vec::is_empty) {
        return Err(GearError::field("the wear table", "without rows", "at least one line below the header"));
    }
    for points in &mut points {
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        if let Some(twice) = points.windows(2).find(|two| two[0].0 == two[1].0) {
            return Err(row_error(
                twice[1].2,
                "radius_mm",
                twice[1].0.to_string(),
                "each radius of a gear once",
            ));
        }
    }
    Ok(points.map(|points| DepthCurve::new(&points.iter().map(|(r, h, _)| (*r, *h)).collect::<Vec<_>>())))
}

fn row_error(line: u64, field: &'static str, value: String, expected: &str) -> GearError {
    GearError::WearTable { line, field, value, expected: expected.to_owned() }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::testing::shen2022;
    use super::DepthCurve;
    use crate::FlankWear;

    #[test]
    fn curve_is_fritsch_and_carlsons() {
        // scipy.interpolate.PchipInterpolator([0, 1, 3, 4], [1, 2, 5, 5.5]) has inner slopes 9/(5/1 + 4/1.5)
        // and 9/(4/1.5 + 5/0.5).
        let curve = DepthCurve::new(&[(0.0, 1.0), (1.0, 2.0), (3.0, 5.0), (4.0, 5.5)]);
        assert!((curve.depth_and_slope(1.0).1 - 9.0 / (5.0 + 4.0 / 1.5)).abs() < 1e-14);
        assert!((curve.slopes[2] - 9.0 / (4.0 / 1.5 + 10.0)).abs() < 1e-14);
        assert_eq!(curve.depth_and_slope(-5.0), (1.0, 0.0));
        assert_eq!(curve.depth_and_slope(5.0), (5.5, 0.0));
    }

    proptest! {
        #[test]
        fn depth_stays_between_its_neighbours_with_a_continuous_slope(
            depths in prop::collection::vec(0.0..200.0_f64, 2..12),
            gaps in prop::collection::vec(0.05..3.0_f64, 12),
        ) {
            let mut radius = 60.0;
            let points: Vec<(f64, f64)> = depths.iter().zip(&gaps).map(|(depth, gap)| { radius += gap; (radius, *depth) }).collect();
            let curve = DepthCurve::new(&points);
            for two in points.windows(2) {
                let (low, high) = (two[0].1.min(two[1].1), two[0].1.max(two[1].1));
                for i in 0..=20 {
                    let at = two[0].0 + (two[1].0 - two[0].0) * f64::from(i) / 20.0;
                    let depth = curve.depth_and_slope(at).0;
                    prop_assert!(depth >= low - 1e-9 && depth <= high + 1e-9);
                }
                // The second derivative is at most 12 · 200/0.05², so the slope changes by less than 0.002
                // over two steps.
                let step = 1e-9;
                for knot in [two[0].0, two[1].0] {
                    let (before, after) = (curve.depth_and_slope(knot - step), curve.depth_and_slope(knot + step));
                    prop_assert!((before.0 - after.0).abs() < 1e-4);
                    prop_assert!((before.1 - after.1).abs() < 2e-3, "{} {}", before.1, after.1);
                }
            }
        }
    }

    #[test]
    fn csv_is_read_in_any_order_and_a_missing_gear_is_unworn() {
        let text = "gear,radius_mm,depth_um\n1, 78.0, 30\n1,69.0,50\n\n1,72,5\n";
        let wear = FlankWear::from_table_csv(&shen2022(), text).unwrap();
        assert!((wear.profiles[0].depth_and_slope(72.0).0 - 0.005).abs() < 1e-15);
        assert!((wear.profiles[0].depth_and_slope(65.0).0 - 0.05).abs() < 1e-15);
        assert_eq!(wear.profiles[1].depth_and_slope(78.0), (0.0, 0.0));
    }

    #[test]
    fn invalid_tables_are_rejected_with_line_field_and_value() {
        let refusal = |rows: &str| {
            let text = format!("gear,radius_mm,depth_um\n{rows}");
            FlankWear::from_table_csv(&shen2022(), &text).unwrap_err().to_string()
        };
        assert!(refusal("1,70,5\n3,70,5\n").starts_with("wear table line 3: gear is \"3\""));
        assert!(refusal("1,70,5\n1,-70,5\n").starts_with("wear table line 3: radius_mm is \"-70\""));
        assert!(refusal("1,70,NaN\n").starts_with("wear table line 2: depth_um is \"NaN\""));
        assert!(refusal("1,70,deep\n").starts_with("wear table line 2: depth_um is \"deep\""));
        assert!(refusal("1,70,-1\n").contains("depth_um is \"-1\""));
        assert!(refusal("1,70,5\n2,80,1\n1,70,6\n").starts_with("wear table line 4: radius_mm is \"70\""));
        assert!(refusal("1,70\n").contains("line: 2"));
        assert!(refusal("").contains("at least one line"));
        assert!(refusal("1,70,9000\n").contains("half of the tooth"));
        let other =
            FlankWear::from_table_csv(&shen2022(), "gear,radius,depth\n1,70,5\n").unwrap_err().to_string();
        assert!(other.contains("gear,radius_mm,depth_um"), "{other}");
        assert!(FlankWear::from_table_csv(&shen2022(), "").is_err());
    }
}
