//! Compliance of one tooth as a beam on the gear's body: potential energy method, one flank worn.

use super::{Flank, FlankPoint, MaterialSpec};

/// Number of panels between the base or root circle and the tip, besides those that kinks of the wear add.
const PANELS: usize = 24;

/// Nodes and weights on [−1, 1] of the six-point Gauss–Legendre rule (Abramowitz and Stegun, table 25.4).
const GAUSS: [(f64, f64); 6] = [
    (-0.932_469_514_203_152, 0.171_324_492_379_170),
    (-0.661_209_386_466_265, 0.360_761_573_048_139),
    (-0.238_619_186_083_197, 0.467_913_934_572_691),
    (0.238_619_186_083_197, 0.467_913_934_572_691),
    (0.661_209_386_466_265, 0.360_761_573_048_139),
    (0.932_469_514_203_152, 0.171_324_492_379_170),
];

/// Compliances of one tooth and its foundation in mm/N.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToothCompliance {
    /// 1/k_b of bending.
    pub bending_mm_per_n: f64,
    /// 1/k_s of shear.
    pub shear_mm_per_n: f64,
    /// 1/k_a of axial compression.
    pub axial_mm_per_n: f64,
    /// 1/k_f of the fillet foundation.
    pub foundation_mm_per_n: f64,
}

impl ToothCompliance {
    /// Returns their sum.
    pub fn total_mm_per_n(&self) -> f64 {
        self.bending_mm_per_n + self.shear_mm_per_n + self.axial_mm_per_n + self.foundation_mm_per_n
    }
}

/// Integrals from the root to a section, for unit width: of 1/I, X/I, X²/I and 1/A with X the distance from
/// the root.
#[derive(Debug, Clone, Copy, Default)]
struct SectionIntegrals {
    inertia: [f64; 3],
    area: f64,
}

impl SectionIntegrals {
    /// Adds a length `dx` of the section of thickness `thickness` at `x`.
    fn add(&mut self, x: f64, thickness: f64, dx: f64) {
        let inertia = 12.0 * dx / thickness.powi(3);
        self.inertia[0] += inertia;
        self.inertia[1] += inertia * x;
        self.inertia[2] += inertia * x * x;
        self.area += dx / thickness;
    }

    /// Adds a part of constant thickness from the root to `length`.
    fn add_straight(&mut self, length: f64, thickness: f64) {
        let inertia = 12.0 / thickness.powi(3);
        self.inertia[0] += inertia * length;
        self.inertia[1] += inertia * length.powi(2) / 2.0;
        self.inertia[2] += inertia * length.powi(3) / 3.0;
        self.area += length / thickness;
    }
}

/// One tooth of a gear as a cantilever, Fig. 10: sections y_worn + y_perfect thick.
///
/// If R_b > R_r (situation 1), the sections between base and root circle are those at the base circle; if R_b
/// ≤ R_r (situation 2), the involute extends down to the root circle.
#[derive(Debug)]
pub(super) struct Tooth<'a> {
    flank: Flank<'a>,
    root_x_mm: f64,
    /// Half the tooth's angle at the root circle, θ_f.
    root_half_angle_rad: f64,
    /// Ends of the quadrature's panels in α₁ with the integrals up to there.
    panels: Vec<(f64, SectionIntegrals)>,
    face_width_mm: f64,
    youngs_modulus_mpa: f64,
    shear_modulus_mpa: f64,
}

impl<'a> Tooth<'a> {
    pub(super) fn new(flank: Flank<'a>, material: &MaterialSpec, face_width_mm: f64) -> Self {
        Self::with_panels(flank, material, face_width_mm, PANELS)
    }

    fn with_panels(flank: Flank<'a>, material: &MaterialSpec, face_width_mm: f64, count: usize) -> Self {
        let gear = flank.gear;
        let mut integrals = SectionIntegrals::default();
        let (start, root_x_mm, root_half_angle_rad);
        if gear.base_radius_mm > gear.root_radius_mm {
            start = -gear.base_half_angle_rad;
            let base = flank.at(start);
            root_half_angle_rad = (base.y_mm / gear.root_radius_mm).asin();
            root_x_mm = gear.root_radius_mm * root_half_angle_rad.cos();
            integrals.add_straight(base.x_mm - root_x_mm, 2.0 * base.y_mm - base.depth_mm);
        } else {
            start = flank.alpha_at_radius_rad(gear.root_radius_mm);
            let root = flank.at(start);
            root_half_angle_rad = root.y_mm.atan2(root.x_mm);
            root_x_mm = root.x_mm;
        }
        let tip = gear.tip_angle_rad;
        let mut ends: Vec<f64> =
            (0..=count).map(|i| start + (tip - start) * i as f64 / count as f64).collect();
        ends.extend(flank.kinks_rad().into_iter().filter(|kink| *kink > start && *kink < tip));
        ends.sort_by(f64::total_cmp);

        let mut tooth = Self {
            flank,
            root_x_mm,
            root_half_angle_rad,
            panels: Vec::with_capacity(ends.len()),
            face_width_mm,
            youngs_modulus_mpa: material.youngs_modulus_pa * 1e-6,
            shear_modulus_mpa: material.youngs_modulus_pa * 1e-6 / (2.0 * (1.0 + material.poisson_ratio)),
        };
        tooth.panels.push((start, integrals));
        for two in ends.windows(2) {
            integrals = tooth.integrate(integrals, two[0], two[1]);
            tooth.panels.push((two[1], integrals));
        }
        tooth
    }

    /// Continues `integrals` from α₁ = `from` to `to`.
    fn integrate(&self, mut integrals: SectionIntegrals, from: f64, to: f64) -> SectionIntegrals {
        let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
        let gear = self.flank.gear;
        for (node, weight) in GAUSS {
            let point = self.flank.at(middle + half * node);
            // dx/dα = R_b (α₁ + α₂) cos α₁.
            let dx =
                gear.base_radius_mm * (point.alpha_rad + gear.base_half_angle_rad) * point.alpha_rad.cos();
            integrals.add(point.x_mm - self.root_x_mm, 2.0 * point.y_mm - point.depth_mm, weight * half * dx);
        }
        integrals
    }

    /// Returns the compliance under a unit force along the worn flank's normal at `load`.
    pub(super) fn compliance(&self, load: &FlankPoint) -> ToothCompliance {
        let panel =
            self.panels.partition_point(|(end, _)| *end <= load.alpha_rad).clamp(1, self.panels.len()) - 1;
        let (from, integrals) = self.panels[panel];
        let SectionIntegrals { inertia, area } = self.integrate(integrals, from, load.alpha_rad);
        let (sin, cos) = load.lambda_sin_cos;
        let arm = load.x_mm - self.root_x_mm;
        let height = load.y_mm - load.depth_mm;
        // ∫ (cos λ (arm − X) − sin λ height)²/I, multiplied out.
        let bending = cos * cos * (arm * arm * inertia[0] - 2.0 * arm * inertia[1] + inertia[2])
            - 2.0 * cos * sin * height * (arm * inertia[0] - inertia[1])
            + sin * sin * height * height * inertia[0];
        ToothCompliance {
            bending_mm_per_n: bending / (self.youngs_modulus_mpa * self.face_width_mm),
            shear_mm_per_n: 1.2 * cos * cos * area / (self.shear_modulus_mpa * self.face_width_mm),
            axial_mm_per_n: sin * sin * area / (self.youngs_modulus_mpa * self.face_width_mm),
            foundation_mm_per_n: self.foundation_mm_per_n(load),
        }
    }

    /// Compliance of the fillet foundation after Sainsot, Velex and Duverger, J. Mech. Des. 126 (2004) 747: a
    /// half-annulus clamped at the bore. The polynomials were fitted for root to bore radii from 1.4 to 7 and
    /// θ_f from 0.01 to 0.12 rad and are extrapolated beyond.
    fn foundation_mm_per_n(&self, load: &FlankPoint) -> f64 {
        let gear = self.flank.gear;
        let (sin, cos) = load.lambda_sin_cos;
        let tan = sin / cos;
        // Intersection of the force's line with the tooth's centre line, above the root circle.
        let u_f = load.x_mm - (load.y_mm - load.depth_mm) * tan - gear.root_radius_mm;
        let s_f = 2.0 * gear.root_radius_mm * self.root_half_angle_rad;
        let h = gear.root_radius_mm / gear.bore_radius_mm;
        let theta = self.root_half_angle_rad;
        let [l, m, p, q] = SAINSOT.map(|[a, b, c, d, e, f]| {
            a / (theta * theta) + b * h * h + c * h / theta + d / theta + e * h + f
        });
        let ratio = u_f / s_f;
        cos * cos / (self.youngs_modulus_mpa * self.face_width_mm)
            * (l * ratio * ratio + m * ratio + p * (1.0 + q * tan * tan))
    }
}

/// Coefficients A … F of L*, M*, P*, Q* in A/θ_f² + B h² + C h/θ_f + D/θ_f + E h + F.
const SAINSOT: [[f64; 6]; 4] = [
    [-5.574e-5, -1.9986e-3, -2.3015e-4, 4.7702e-3, 0.0271, 6.8045],
    [60.111e-5, 28.100e-3, -83.431e-4, -9.9256e-3, 0.1624, 0.9086],
    [-50.952e-5, 185.50e-3, 0.0538e-4, 53.300e-3, 0.2895, 0.9236],
    [-6.2042e-5, 9.0889e-3, -4.0964e-4, 7.8297e-3, -0.1472, 0.6904],
];

#[cfg(test)]
mod tests {
    use super::super::testing::{shen2022_spec, typical_wear};
    use super::{Flank, Tooth};
    use crate::{FlankWear, GearPair};

    /// Composite Simpson rule.
    fn simpson(f: impl Fn(f64) -> f64, from: f64, to: f64, count: usize) -> f64 {
        let h = (to - from) / count as f64;
        let inner: f64 =
            (1..count).map(|i| if i % 2 == 1 { 4.0 } else { 2.0 } * f(from + h * i as f64)).sum();
        (f(from) + inner + f(to)) * h / 3.0
    }

    /// 1/k_b, 1/k_s, 1/k_a straight from their definitions over x, the section at x found by bisection on the
    /// flank.
    fn defined(pair: &GearPair, flank: &Flank, alpha: f64) -> [f64; 3] {
        let gear = flank.gear;
        let load = flank.at(alpha);
        let (sin, cos) = load.lambda_rad.sin_cos();
        let situation_1 = gear.base_radius_mm > gear.root_radius_mm;
        let lowest = if situation_1 {
            -gear.base_half_angle_rad
        } else {
            flank.alpha_at_radius_rad(gear.root_radius_mm)
        };
        let low = flank.at(lowest);
        let root_x =
            if situation_1 { (gear.root_radius_mm.powi(2) - low.y_mm.powi(2)).sqrt() } else { low.x_mm };
        let thickness = |x: f64| {
            if x <= low.x_mm {
                return 2.0 * low.y_mm - low.depth_mm;
            }
            let (mut a, mut b) = (lowest, alpha);
            for _ in 0..60 {
                let middle = 0.5 * (a + b);
                if flank.at(middle).x_mm < x { a = middle } else { b = middle }
            }
            let point = flank.at(a);
            2.0 * point.y_mm - point.depth_mm
        };
        let width = pair.spec.geometry.face_width_mm;
        let young = pair.spec.material.youngs_modulus_pa * 1e-6;
        let shear = young / (2.0 * (1.0 + pair.spec.material.poisson_ratio));
        let height = load.y_mm - load.depth_mm;
        let moment = |x: f64| cos * (load.x_mm - x) - sin * height;
        let integral = |f: &dyn Fn(f64) -> f64| {
            simpson(f, root_x, low.x_mm, 200) + simpson(f, low.x_mm, load.x_mm, 4000)
        };
        [
            integral(&|x| moment(x).powi(2) / (young * width * thickness(x).powi(3) / 12.0)),
            integral(&|x| 1.2 * cos * cos / (shear * width * thickness(x))),
            integral(&|x| sin * sin / (young * width * thickness(x))),
        ]
    }

    /// The pair of Table 1, R_b > R_r, and one with more teeth, R_b ≤ R_r, both worn.
    fn both_situations() -> Vec<(GearPair, FlankWear)> {
        let mut spec = shen2022_spec();
        spec.geometry.teeth = [60, 70];
        spec.geometry.centre_distance_mm = None;
        spec.geometry.bore_radius_mm = Some([60.0, 60.0]);
        let pair = spec.resolve().unwrap();
        assert!(pair.gears[0].base_radius_mm < pair.gears[0].root_radius_mm);
        let wear = FlankWear::from_shape(&pair, 0.1).unwrap();
        vec![typical_wear(), (pair, wear)]
    }

    #[test]
    fn compliances_are_the_integrals_of_their_definitions() {
        for (pair, wear) in both_situations() {
            for (i, gear) in pair.gears.iter().enumerate() {
                let flank = Flank::new(gear, &wear, i);
                let tooth = Tooth::new(flank.clone(), &pair.spec.material, pair.spec.geometry.face_width_mm);
                for part in [0.02, 0.37, 0.71, 1.0] {
                    let alpha = gear.root_angle_rad + part * (gear.tip_angle_rad - gear.root_angle_rad);
                    let found = tooth.compliance(&flank.at(alpha));
                    for (found, wanted) in
                        [found.bending_mm_per_n, found.shear_mm_per_n, found.axial_mm_per_n]
                            .into_iter()
                            .zip(defined(&pair, &flank, alpha))
                    {
                        assert!((found / wanted - 1.0).abs() < 2e-6, "{found} for {wanted}");
                    }
                }
            }
        }
    }

    #[test]
    fn more_panels_change_nothing() {
        for (pair, wear) in both_situations() {
            let flank = Flank::new(&pair.gears[0], &wear, 0);
            let teeth =
                [12, 24, 96].map(|count| Tooth::with_panels(flank.clone(), &pair.spec.material, 50.0, count));
            for point in flank.active_points(37) {
                let [coarse, used, fine] =
                    teeth.each_ref().map(|tooth| tooth.compliance(&point).total_mm_per_n());
                assert!((used / fine - 1.0).abs() < 1e-13, "{}", used / fine - 1.0);
                assert!((coarse / fine - 1.0).abs() < 1e-11, "{}", coarse / fine - 1.0);
            }
        }
    }

    #[test]
    fn a_worn_tooth_is_softer_under_the_same_load() {
        let (pair, wear) = typical_wear();
        let none = FlankWear::none();
        let tooth = |wear| Tooth::new(Flank::new(&pair.gears[0], wear, 0), &pair.spec.material, 50.0);
        let load = Flank::new(&pair.gears[0], &none, 0).at(0.4);
        let (worn, perfect) = (tooth(&wear).compliance(&load), tooth(&none).compliance(&load));
        assert!(
            worn.bending_mm_per_n > perfect.bending_mm_per_n
                && worn.shear_mm_per_n > perfect.shear_mm_per_n
                && worn.axial_mm_per_n > perfect.axial_mm_per_n
        );
        assert!(worn.bending_mm_per_n < 1.02 * perfect.bending_mm_per_n);
    }
}
