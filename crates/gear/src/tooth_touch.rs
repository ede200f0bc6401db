//! First contact of the two teeth of one pair, for any wear and rotation: flank on flank inside the nominal
//! range of contact, a tip edge on the other flank outside of it.
//!
//! A point of the driving flank at rotation φ₁ lies on a circle about the driven gear's centre. When turned
//! back, the driven tooth's point on that circle reaches it at φ₂ = ψ₂ + γ₂ (Eq. (15)). The teeth touch at
//! the largest φ₂ of all such points. If the maximum is inside the range, its zero slope is the common
//! tangent, Eq. (11); at an end of either flank it is corner contact.

use super::line_contact::LineContact;
use super::tooth_outline::{Point, ToothOutline};
use super::{Flank, FlankPoint, FlankWear, GearPair, root};

/// Number of points of the driven flank's table, and of the driving flank searched for the largest φ₂.
const DRIVEN_POINTS: usize = 320;
const DRIVING_POINTS: usize = 80;
/// Step in points of the first scan of the driving flank.
const SCAN_STEP: usize = 4;
/// Accuracy of α₁ in rad.
const TOLERANCE_RAD: f64 = 1e-11;
/// Half-length of the flank in modules over which the curvature is evaluated.
const CURVATURE_REACH_MODULES: f64 = 0.05;
/// Smallest relative curvature in 1/modules; flatter worn flanks use this value.
const MIN_CURVATURE: f64 = 0.06;

/// The first touch of one pair of teeth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ToothTouch {
    /// φ₂ in rad at which the driven tooth touches.
    pub(super) phi2_rad: f64,
    /// Radii in mm of the unworn points below the contact, on both flanks.
    pub(super) radii_mm: [f64; 2],
    /// The contact's normal out of each tooth in its own coordinates.
    pub(super) normals: [Point; 2],
    /// Distances in mm of the gears' centres from the normal.
    pub(super) arms_mm: [f64; 2],
    /// Shape of the contact line.
    pub(super) line: LineContact,
    /// The gear (0 or 1) whose tip edge is nearest.
    pub(super) edge: usize,
}

/// One pair of teeth with its worn flanks.
#[derive(Debug, Clone)]
pub(super) struct ToothPair<'a> {
    driving: Flank<'a>,
    points: Vec<FlankPoint>,
    driven: DrivenFlank,
    centre_mm: f64,
    module_mm: f64,
}

/// The driven flank over its worn radius.
#[derive(Debug, Clone)]
struct DrivenFlank {
    /// Worn radius, γ, dγ/dr, λ and unworn radius.
    table: Vec<[f64; 5]>,
    base_mm: f64,
    /// √(r² − R_b²) at both ends.
    lengths_mm: (f64, f64),
}

/// A point of the driven flank.
#[derive(Debug, Clone, Copy)]
struct DrivenPoint {
    gamma_rad: f64,
    lambda_rad: f64,
    radius_mm: f64,
}

impl DrivenFlank {
    fn new(flank: &Flank<'_>, outline: &ToothOutline) -> Self {
        let row = |point: FlankPoint| {
            let (gamma, radius) = (point.gamma_rad(), point.worn_radius_mm());
            let slope = -(point.lambda_rad + gamma).tan() / radius;
            [radius, gamma, slope, point.lambda_rad, point.radius_mm]
        };
        let table: Vec<[f64; 5]> =
            involute_points(flank, outline, DRIVEN_POINTS).into_iter().map(row).collect();
        let base_mm = flank.gear.base_radius_mm;
        let length = |row: &[f64; 5]| (row[0] * row[0] - base_mm * base_mm).max(0.0).sqrt();
        Self { lengths_mm: (length(&table[0]), length(&table[table.len() - 1])), table, base_mm }
    }

    /// Returns the radii between which the flank exists.
    fn range(&self) -> (f64, f64) {
        (self.table[0][0], self.table[self.table.len() - 1][0])
    }

    fn at(&self, radius_mm: f64) -> DrivenPoint {
        // The table has equal steps of α₁, which is √(r² − R_b²) without wear: a first guess, followed by a
        // step or two.
        let last = self.table.len() - 1;
        let length = (radius_mm * radius_mm - self.base_mm * self.base_mm).max(0.0).sqrt();
        let part = (length - self.lengths_mm.0) / (self.lengths_mm.1 - self.lengths_mm.0);
        let mut after = ((part.max(0.0) * last as f64) as usize + 1).min(last);
        while after < last && self.table[after][0] <= radius_mm {
            after += 1;
        }
        while after > 1 && self.table[after - 1][0] > radius_mm {
            after -= 1;
        }
        let (a, b) = (&self.table[after - 1], &self.table[after]);
        let width = b[0] - a[0];
        let t = (radius_mm - a[0]) / width;
        let (rise, m0, m1) = (b[1] - a[1], a[2] * width, b[2] * width);
        DrivenPoint {
            gamma_rad: a[1] + t * (m0 + t * (3.0 * rise - 2.0 * m0 - m1 + t * (m0 + m1 - 2.0 * rise))),
            lambda_rad: a[3] + t * (b[3] - a[3]),
            radius_mm: a[4] + t * (b[4] - a[4]),
        }
    }
}

/// Returns points at equal steps of α₁ from the end of the fillet to the tip.
fn involute_points(flank: &Flank<'_>, outline: &ToothOutline, count: usize) -> Vec<FlankPoint> {
    let (form, tip) = (flank.alpha_at_radius_rad(outline.form_radius_mm), flank.gear.tip_angle_rad);
    (0..=count).map(|i| flank.at(form + (tip - form) * i as f64 / count as f64)).collect()
}

/// Returns the position from 0 to `end` of the maximum of a function with few peaks, none much narrower than
/// [`SCAN_STEP`]: scanned in these steps, then completely around each peak found.
fn highest(end: usize, value: impl Fn(usize) -> f64) -> usize {
    let scanned: Vec<(usize, f64)> =
        (0..end).step_by(SCAN_STEP).chain([end]).map(|i| (i, value(i))).collect();
    let mut best = (0, f64::NEG_INFINITY);
    for (j, (i, here)) in scanned.iter().enumerate() {
        let (before, after) = (j.checked_sub(1).map(|j| scanned[j]), scanned.get(j + 1));
        if before.is_some_and(|(_, value)| value > *here) || after.is_some_and(|(_, value)| value > here) {
            continue;
        }
        let around = before.map_or(0, |(i, _)| i + 1)..after.map_or(end + 1, |(i, _)| *i);
        for near in around {
            let value = if near == *i { *here } else { value(near) };
            if value > best.1 {
                best = (near, value);
            }
        }
    }
    best.0
}

/// The driven tooth against one point of the driving flank.
#[derive(Debug, Clone, Copy)]
struct Reach {
    /// φ₂ at which the driven tooth reaches the point.
    phi2_rad: f64,
    /// Radius of the point about the driven centre.
    radius_mm: f64,
    driven: DrivenPoint,
}

impl<'a> ToothPair<'a> {
    pub(super) fn new(pair: &'a GearPair, wear: &'a FlankWear, outlines: &[ToothOutline; 2]) -> Self {
        let [driving, driven] = [0, 1].map(|i| Flank::new(&pair.gears[i], wear, i));
        Self {
            points: involute_points(&driving, &outlines[0], DRIVING_POINTS),
            driven: DrivenFlank::new(&driven, &outlines[1]),
            driving,
            centre_mm: pair.centre_distance_mm,
            module_mm: pair.spec.geometry.module_mm,
        }
    }

    /// Returns the squared distance of a driving point from the driven centre, and its components along and
    /// across the line of centres; `turned` has sine and cosine of φ₁.
    fn driven_polar(&self, point: &FlankPoint, (sin, cos): (f64, f64)) -> (f64, f64, f64) {
        let (x, y) = (point.x_mm, point.y_mm - point.depth_mm);
        let (beside, above) = (self.centre_mm - (x * cos - y * sin), x * sin + y * cos);
        (beside * beside + above * above, beside, above)
    }

    fn reach(&self, point: &FlankPoint, turned: (f64, f64)) -> Reach {
        let (squared, beside, above) = self.driven_polar(point, turned);
        let radius_mm = squared.sqrt();
        let driven = self.driven.at(radius_mm);
        Reach { phi2_rad: above.atan2(beside) + driven.gamma_rad, radius_mm, driven }
    }

    /// Returns the angle between the tangents of the driving point and of the driven one that reaches it: φ₂
    /// increases along the driving flank if it is negative.
    fn turn(&self, point: &FlankPoint, reach: &Reach, phi1_rad: f64) -> f64 {
        (point.lambda_rad - phi1_rad) - (reach.driven.lambda_rad + reach.phi2_rad)
    }

    /// Returns φ₂ at which the driven tooth reaches a point of the driving flank at φ₁, whose sine and cosine
    /// are `turned`, the radius in mm of the unworn driven point that does, and the driving point's position
    /// in mm before the driven centre and above the line of centres; `None` beyond the driven flank's ends.
    pub(super) fn meeting(&self, point: &FlankPoint, turned: (f64, f64)) -> Option<(f64, f64, [f64; 2])> {
        let (squared, beside, above) = self.driven_polar(point, turned);
        let radius = squared.sqrt();
        let (least, most) = self.driven.range();
        if radius < least || radius > most {
            return None;
        }
        let driven = self.driven.at(radius);
        Some((above.atan2(beside) + driven.gamma_rad, driven.radius_mm, [beside, above]))
    }

    /// Returns the first contact at φ₁ = `phi1_rad` of the driving tooth; `None` if the teeth cannot reach
    /// each other.
    pub(super) fn touch(&self, phi1_rad: f64) -> Option<ToothTouch> {
        let turned = phi1_rad.sin_cos();
        let (least, most) = self.driven.range();
        let polar = |point: &FlankPoint| self.driven_polar(point, turned);
        // The distance from the driven centre decreases along the driving flank.
        let first = self.points.iter().position(|point| polar(point).0 <= most * most)?;
        let last = self.points.iter().rposition(|point| polar(point).0 >= least * least)?;
        if last < first {
            return None;
        }
        let alpha = |i: usize| self.points[i].alpha_rad;
        let limit = |inside: usize, outside: usize, wanted: f64| {
            let value = |alpha: f64| polar(&self.driving.at(alpha)).0 - wanted * wanted;
            let (low, high) = (alpha(inside.min(outside)), alpha(inside.max(outside)));
            root::find(value, (low, value(low)), (high, value(high)), TOLERANCE_RAD)
        };
        let low = if first > 0 { limit(first, first - 1, most) } else { alpha(0) };
        let high = if last + 1 < self.points.len() { limit(last, last + 1, least) } else { alpha(last) };
        let at = |alpha: f64| {
            let point = self.driving.at(alpha);
            let reach = self.reach(&point, turned);
            (point, reach)
        };
        // Both limits and the points between them.
        let inner = first + usize::from(alpha(first) <= low)..last + usize::from(alpha(last) < high);
        let end = inner.len() + 1;
        let place = |i: usize| match i {
            0 => low,
            i if i == end => high,
            i => alpha(inner.start + i - 1),
        };
        let phi2 = |i: usize| match i {
            0 => at(low).1.phi2_rad,
            i if i == end => at(high).1.phi2_rad,
            i => self.reach(&self.points[inner.start + i - 1], turned).phi2_rad,
        };
        let best = highest(end, phi2);
        let (before, after) = (place(best.saturating_sub(1)), place((best + 1).min(end)));
        let turn = |alpha: f64| {
            let (point, reach) = at(alpha);
            self.turn(&point, &reach, phi1_rad)
        };
        let (rises, falls) = (turn(before), turn(after));
        let touching = if rises < 0.0 && falls > 0.0 {
            root::find(turn, (before, rises), (after, falls), TOLERANCE_RAD)
        } else {
            place(best)
        };
        Some(self.describe(phi1_rad, touching, (low, high), first > 0))
    }

    /// Describes the contact at α₁ = `place`, given the part of the driving flank that the driven one
    /// reaches, and whether it starts at the driven tip.
    fn describe(&self, phi1_rad: f64, place: f64, (low, high): (f64, f64), tip_reaches: bool) -> ToothTouch {
        let turned = phi1_rad.sin_cos();
        let at = |alpha: f64| {
            let point = self.driving.at(alpha);
            let reach = self.reach(&point, turned);
            (point, reach)
        };
        let (point, reach) = at(place);
        let turn = self.turn(&point, &reach, phi1_rad);
        let driving_edge = place >= high && turn < 0.0;
        // At the driving tip's edge the normal is the driven flank's, else the driving one's.
        let normal_rad =
            if driving_edge { reach.driven.lambda_rad + reach.phi2_rad } else { point.lambda_rad - phi1_rad };
        let normals = [normal_rad + phi1_rad, normal_rad - reach.phi2_rad].map(|angle| {
            let (sin, cos) = angle.sin_cos();
            [sin, cos]
        });
        let (sin, cos) = reach.driven.gamma_rad.sin_cos();
        let places =
            [[point.x_mm, point.y_mm - point.depth_mm], [reach.radius_mm * cos, reach.radius_mm * sin]];
        let arms_mm = [0, 1].map(|i| places[i][0] * normals[i][1] - places[i][1] * normals[i][0]);

        let position = |alpha: f64| {
            let point = self.driving.at(alpha);
            [point.x_mm, point.y_mm - point.depth_mm]
        };
        let distance = |a: Point, b: Point| (a[0] - b[0]).hypot(a[1] - b[1]);
        // Second difference of the angular gap around the contact, over the flank's length.
        let gear = self.driving.gear;
        let along = gear.base_radius_mm * (place + gear.base_half_angle_rad);
        let step = (CURVATURE_REACH_MODULES * self.module_mm / along.max(0.1 * self.module_mm))
            .min(0.499 * (high - low));
        let middle = place.clamp(low + step, high - step);
        let three = [middle - step, middle, middle + step].map(|alpha| at(alpha).1.phi2_rad);
        let half_length = 0.5 * distance(position(middle - step), position(middle + step));
        let bend = (2.0 * three[1] - three[0] - three[2]) * arms_mm[1] / (half_length * half_length);
        let curvature_per_mm = if bend.is_finite() { bend } else { 0.0 }.max(MIN_CURVATURE / self.module_mm);

        let from_driven_tip = if tip_reaches { distance(places[0], position(low)) } else { f64::INFINITY };
        let from_driving_tip = distance(places[0], position(self.driving.gear.tip_angle_rad));
        let edge = usize::from(from_driven_tip < from_driving_tip);
        let edge_angle_rad = if driving_edge {
            -turn
        } else if place <= low && turn > 0.0 {
            turn
        } else {
            -curvature_per_mm * from_driven_tip.min(from_driving_tip)
        };
        ToothTouch {
            phi2_rad: reach.phi2_rad,
            radii_mm: [point.radius_mm, reach.driven.radius_mm],
            normals,
            arms_mm,
            line: LineContact { curvature_per_mm, edge_angle_rad },
            edge,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::ToothPair;
    use crate::testing::{shen2022, typical_wear};
    use crate::tooth_outline::ToothOutline;
    use crate::{Flank, FlankWear, GearPair};

    fn outlines(pair: &GearPair) -> [ToothOutline; 2] {
        [0, 1].map(|i| ToothOutline::new(pair, i))
    }

    /// `fixtures/reference/mesh-stiffness-fe/K_perfect_pair0_only.csv` has the rotation θ₀ that brings the
    /// teeth together outside the nominal range: 187 µrad and less before it, 190 µrad and less behind it.
    #[test]
    fn tip_edges_touch_where_the_finite_element_reference_has_them() {
        let (pair, wear) = (shen2022(), FlankWear::none());
        let teeth = ToothPair::new(&pair, &wear, &outlines(&pair));
        let ratio = pair.gears[0].base_radius_mm / pair.gears[1].base_radius_mm;
        let mut corners = 0;
        for line in include_str!("../../../fixtures/reference/mesh-stiffness-fe/K_perfect_pair0_only.csv")
            .lines()
            .skip(1)
        {
            let numbers: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
            let (phi1, theta) = (numbers[0], numbers[5]);
            let rolled = ratio * phi1 - pair.perfect_lag_rad();
            let touch = teeth.touch(phi1 + theta).unwrap();
            // The reference sees touches at its nodes, 0.025 mm apart: times the edge's angle (0.03) that is
            // 0.8 µm, and 5.1 µrad is what it differs by at most; the scan below is the exact check.
            assert!((touch.phi2_rad - rolled).abs() < 6e-6, "{phi1}: {}", touch.phi2_rad - rolled);
            corners += usize::from(touch.line.edge_angle_rad > 1e-3);
        }
        assert!(corners >= 4, "{corners}");
    }

    /// Against a scan of the driving flank in steps of 10 µm with the driven point found by bisection: no
    /// point lies deeper than the touch, inside the range and at both edges.
    #[test]
    fn no_point_of_the_flanks_overlaps() {
        let (pair, wear) = typical_wear();
        let teeth = ToothPair::new(&pair, &wear, &outlines(&pair));
        let [driving, driven] = [0, 1].map(|i| Flank::new(&pair.gears[i], &wear, i));
        let tip = driven.at(pair.gears[1].tip_angle_rad).worn_radius_mm();
        for phi1 in [-0.30, -0.285, -0.25, -0.1, 0.0, 0.12, 0.155] {
            let mut greatest = f64::NEG_INFINITY;
            for point in driving.active_points(1000) {
                let angle = point.gamma_rad() + phi1;
                let (x, y) = (point.worn_radius_mm() * angle.cos(), point.worn_radius_mm() * angle.sin());
                let radius = (pair.centre_distance_mm - x).hypot(y);
                let (mut low, mut high) = (pair.gears[1].root_angle_rad, pair.gears[1].tip_angle_rad);
                if radius > tip || radius < driven.at(low).worn_radius_mm() {
                    continue;
                }
                for _ in 0..60 {
                    let middle = 0.5 * (low + high);
                    if driven.at(middle).worn_radius_mm() < radius {
                        low = middle;
                    } else {
                        high = middle;
                    }
                }
                greatest = greatest.max(y.atan2(pair.centre_distance_mm - x) + driven.at(low).gamma_rad());
            }
            let touch = teeth.touch(phi1).unwrap();
            // A step of 10 µm beside a touch leaves κ t²/2 or β t of the gap: 0.5 µm at the edges.
            assert!(touch.phi2_rad >= greatest - 1e-10, "{phi1}: {}", touch.phi2_rad - greatest);
            assert!(touch.phi2_rad <= greatest + 1e-5, "{phi1}: {}", touch.phi2_rad - greatest);
        }
    }
}
