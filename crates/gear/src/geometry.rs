//! Macro-geometry of a pair, computed from its basic data and validated.

use std::f64::consts::{FRAC_PI_2, PI};

use super::refusals::Refusals;
use super::{Errors, GearError, GeometrySpec, PairSpec, Supports, limits};

/// Thinnest tip in modules that does not count as pointed: wear of the usual greatest depth, 0.04 modules,
/// leaves part of each half.
pub(super) const MIN_TIP_THICKNESS_MODULES: f64 = 0.1;

/// One gear of a pair. Angles of flank points are the paper's α₁: the angle between the flank's normal there
/// and the tooth's Y axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Gear {
    /// Tooth number z.
    pub teeth: u32,
    /// Reference pitch radius m·z/2 in mm.
    pub reference_radius_mm: f64,
    /// Operating pitch radius in mm: where the teeth roll without sliding.
    pub pitch_radius_mm: f64,
    /// Base radius R_b in mm.
    pub base_radius_mm: f64,
    /// Tip radius in mm.
    pub tip_radius_mm: f64,
    /// Root radius R_r in mm.
    pub root_radius_mm: f64,
    /// Bore radius in mm.
    pub bore_radius_mm: f64,
    /// Half the tooth's angle at the base circle, α₂ in rad.
    pub base_half_angle_rad: f64,
    /// Angle c of the start of active profile in rad: where the mating tip enters or leaves.
    pub root_angle_rad: f64,
    /// Angle a of the tip in rad.
    pub tip_angle_rad: f64,
    /// Radius of the start of active profile in mm.
    pub sap_radius_mm: f64,
    /// Mass in kg.
    pub mass_kg: f64,
    /// Moment of inertia in kg·m².
    pub inertia_kg_m2: f64,
}

/// A gear pair with validated numbers and computed geometry; gear 1, `gears[0]`, drives.
#[derive(Debug, Clone, PartialEq)]
pub struct GearPair {
    /// The description of the pair.
    pub spec: PairSpec,
    /// Driving and driven gear.
    pub gears: [Gear; 2],
    /// Operating centre distance a_ω in mm.
    pub centre_distance_mm: f64,
    /// Operating pressure angle in rad; equals the paper's α₀ at the reference centre distance.
    pub pressure_angle_rad: f64,
    /// Supports, given or default.
    pub supports: Supports,
    /// Manufacturing errors, given or default.
    pub errors: Errors,
}

impl PairSpec {
    /// Validates every number and computes the geometry. Whether worn flanks still carry load is checked by
    /// [`PairSpec::check`].
    ///
    /// # Errors
    /// [`GearError::Field`] with the first invalid field, its value and the limit.
    pub fn resolve(&self) -> Result<GearPair, GearError> {
        let mut refusals = Refusals::default();
        let pair = GearPair::draft(self, &mut refusals);
        refusals.first().and_then(|()| {
            pair.ok_or_else(|| GearError::field("geometry", "no pair", "two gears that can mesh"))
        })
    }
}

impl GearPair {
    /// Computes the geometry as far as possible, and collects all errors in order.
    pub(super) fn draft(spec: &PairSpec, refusals: &mut Refusals) -> Option<Self> {
        let basic = &spec.geometry;
        limits::check_basic(basic, refusals);
        let is_in_range = refusals.is_empty();
        limits::check_physics(spec, refusals);
        if !is_in_range {
            return None;
        }

        let alpha0 = basic.pressure_angle_deg.to_radians();
        let reference = basic.teeth.map(|z| basic.module_mm * f64::from(z) / 2.0);
        let base = reference.map(|r| r * alpha0.cos());
        refusals.check(limits::check_load(spec, base));
        let zero_backlash = refusals.take(zero_backlash_angle(basic, alpha0))?;
        let least_centre_mm = (base[0] + base[1]) / zero_backlash.cos();
        let centre_distance_mm = basic.centre_distance_mm.unwrap_or(least_centre_mm);
        refusals.check(limits::check_centre(basic, centre_distance_mm, base, least_centre_mm));
        if centre_distance_mm <= base[0] + base[1] {
            return None;
        }
        let pressure_angle_rad = ((base[0] + base[1]) / centre_distance_mm).acos();

        let tip =
            [0, 1].map(|i| reference[i] + (basic.addendum[i] + basic.profile_shift[i]) * basic.module_mm);
        let (root, bore) = (basic.root_radius_mm(), basic.bore_radius_mm());
        let mut gears = Vec::with_capacity(2);
        for i in 0..2 {
            limits::check_tooth(basic, i, [base[i], tip[i], root[i], bore[i]], alpha0, refusals);
            if tip[i] + root[1 - i] > centre_distance_mm + 1e-9 {
                let most = (centre_distance_mm - root[1 - i] - reference[i]) / basic.module_mm
                    - basic.profile_shift[i];
                let expected =
                    format!("at most {most:.4}, where the tip of gear {} reaches the other's root", i + 1);
                refusals.add(GearError::field("geometry.addendum", basic.addendum[i], expected));
            }
            let teeth = f64::from(basic.teeth[i]);
            let base_half_angle_rad =
                FRAC_PI_2 / teeth + involute(alpha0) + 2.0 * basic.profile_shift[i] * alpha0.tan() / teeth;
            let sap_length_mm =
                centre_distance_mm * pressure_angle_rad.sin() - flank_length(tip[1 - i], base[1 - i]);
            refusals.check(limits::check_active_profile(basic, i, sap_length_mm, alpha0));
            gears.push(Gear {
                teeth: basic.teeth[i],
                reference_radius_mm: reference[i],
                pitch_radius_mm: base[i] / pressure_angle_rad.cos(),
                base_radius_mm: base[i],
                tip_radius_mm: tip[i],
                root_radius_mm: root[i],
                bore_radius_mm: bore[i],
                base_half_angle_rad,
                root_angle_rad: sap_length_mm / base[i] - base_half_angle_rad,
                tip_angle_rad: flank_length(tip[i], base[i]) / base[i] - base_half_angle_rad,
                sap_radius_mm: base[i].hypot(sap_length_mm),
                mass_kg: mass(spec, i, reference[i]),
                inertia_kg_m2: inertia(spec, i, reference[i]),
            });
        }
        refusals.check(limits::check_reach(centre_distance_mm, tip));
        let gears = <[Gear; 2]>::try_from(gears).ok()?;
        let pair = Self {
            spec: spec.clone(),
            gears,
            centre_distance_mm,
            pressure_angle_rad,
            supports: spec.supports(),
            errors: spec.errors(),
        };
        pair.check_tips(refusals);
        Some(pair)
    }

    /// Returns the contact ratio of the unworn pair: mesh periods that one pair of teeth stays in contact.
    pub fn contact_ratio(&self) -> f64 {
        (self.gears[0].tip_angle_rad - self.gears[0].root_angle_rad) / self.gears[0].pitch_angle_rad()
    }

    /// Returns the nominal start of contact of a pair of teeth: φ₁ in rad at which the driven tip meets the
    /// driving start of active profile.
    pub fn start_of_contact_rad(&self) -> f64 {
        self.gears[0].root_angle_rad - self.pressure_angle_rad
    }

    /// Returns φ₁ R_b1/R_b2 − φ₂ of perfect flanks in rad, the same at every rotation: from φ₁ = α₁ − α, φ₂ =
    /// α − α₁′ and R_b1 (α₁ + α₂) + R_b2 (α₁′ + α₂′) = a sin α.
    pub fn perfect_lag_rad(&self) -> f64 {
        let [driving, driven] = &self.gears;
        let angle = self.pressure_angle_rad;
        let line = self.centre_distance_mm * angle.sin();
        let thickness = |gear: &Gear| gear.base_radius_mm * (gear.base_half_angle_rad + angle);
        (line - thickness(driving) - thickness(driven)) / driven.base_radius_mm
    }

    /// Returns the mass m_e in kg of the relative rotation along the line of action: 1/m_e = R_b1²/I₁ +
    /// R_b2²/I₂.
    pub fn mesh_mass_kg(&self) -> f64 {
        let part = |gear: &Gear| (gear.base_radius_mm * 1e-3).powi(2) / gear.inertia_kg_m2;
        1.0 / (part(&self.gears[0]) + part(&self.gears[1]))
    }

    /// Checks for pointed tips and the contact ratio, which need the whole geometry.
    fn check_tips(&self, refusals: &mut Refusals) {
        for (i, gear) in self.gears.iter().enumerate() {
            let thickness = gear.tip_thickness_mm() / self.spec.geometry.module_mm;
            if thickness < MIN_TIP_THICKNESS_MODULES {
                let expected = format!(
                    "a smaller value: the tip of gear {} would be {thickness:.3} modules thick, below {MIN_TIP_THICKNESS_MODULES} it is pointed",
                    i + 1
                );
                refusals.add(GearError::field("geometry.addendum", self.spec.geometry.addendum[i], expected));
            }
        }
        let ratio = self.contact_ratio();
        if ratio < 1.0 {
            let expected = format!(
                "a longer tooth or more teeth: the contact ratio is {ratio:.4}, at least 1 is needed for continuous contact"
            );
            refusals.add(GearError::field(
                "geometry.addendum",
                format!("{:?}", self.spec.geometry.addendum),
                expected,
            ));
        }
    }
}

impl Gear {
    /// Returns the pitch angle 2π/z in rad.
    pub fn pitch_angle_rad(&self) -> f64 {
        2.0 * PI / f64::from(self.teeth)
    }

    /// Returns the thickness of the unworn tip in mm, along the tip circle.
    pub fn tip_thickness_mm(&self) -> f64 {
        let half_angle = (self.base_radius_mm / self.tip_radius_mm).acos() - self.tip_angle_rad;
        2.0 * self.tip_radius_mm * half_angle
    }
}

/// inv α = tan α − α.
fn involute(angle: f64) -> f64 {
    angle.tan() - angle
}

/// Length of the line from the base circle's tangent point to the involute's point at `radius`.
fn flank_length(radius: f64, base: f64) -> f64 {
    (radius * radius - base * base).max(0.0).sqrt()
}

/// Operating pressure angle of zero backlash: inv α = inv α₀ + 2 tan α₀ (x₁ + x₂)/(z₁ + z₂), by Newton's
/// method.
fn zero_backlash_angle(basic: &GeometrySpec, alpha0: f64) -> Result<f64, GearError> {
    let teeth = f64::from(basic.teeth[0]) + f64::from(basic.teeth[1]);
    let shift = basic.profile_shift[0] + basic.profile_shift[1];
    let target = involute(alpha0) + 2.0 * alpha0.tan() * shift / teeth;
    if target <= 1e-9 {
        let expected = format!(
            "a sum above {:.4}, where the pressure angle vanishes",
            -involute(alpha0) * teeth / (2.0 * alpha0.tan())
        );
        return Err(GearError::field(
            "geometry.profile_shift",
            format!("{:?}", basic.profile_shift),
            expected,
        ));
    }
    if shift == 0.0 {
        return Ok(alpha0);
    }
    // inv is convex and increasing: from above the root, Newton's steps decrease monotonically to it.
    let mut angle = (3.0 * target).cbrt().min(1.5);
    for _ in 0..60 {
        let step = (involute(angle) - target) / angle.tan().powi(2);
        angle -= step;
        if step.abs() < 1e-16 {
            break;
        }
    }
    Ok(angle)
}

fn disc_mass(spec: &PairSpec, radius_mm: f64) -> f64 {
    spec.material.density_kg_per_m3 * PI * (radius_mm * 1e-3).powi(2) * spec.geometry.face_width_mm * 1e-3
}

fn mass(spec: &PairSpec, i: usize, radius_mm: f64) -> f64 {
    spec.dynamics.mass_kg.map_or_else(|| disc_mass(spec, radius_mm), |masses| masses[i])
}

fn inertia(spec: &PairSpec, i: usize, radius_mm: f64) -> f64 {
    let disc = || disc_mass(spec, radius_mm) * (radius_mm * 1e-3).powi(2) / 2.0;
    spec.dynamics.inertia_kg_m2.map_or_else(disc, |inertias| inertias[i])
}

#[cfg(test)]
mod tests {
    use super::super::testing::shen2022_spec;

    #[test]
    fn centre_distance_follows_from_the_profile_shifts() {
        // Niemann/Winter's formulae by hand: z 20/40, m 3, x 0.3/0.2; inv α_w = inv 20° + 2 tan 20° 0.5/60 =
        // 0.020 970 7, α_w = 22.336°, a = 90 cos 20°/cos α_w.
        let mut spec = shen2022_spec();
        spec.geometry.teeth = [20, 40];
        spec.geometry.module_mm = 3.0;
        spec.geometry.profile_shift = [0.3, 0.2];
        spec.geometry.bore_radius_mm = Some([10.0, 10.0]);
        spec.geometry.centre_distance_mm = None;
        let pair = spec.resolve().unwrap();
        let angle = pair.pressure_angle_rad;
        assert!((angle.tan() - angle - 0.020_970_7).abs() < 2e-7, "inv {}", angle.tan() - angle);
        assert!((pair.centre_distance_mm - 90.0 * 20.0_f64.to_radians().cos() / angle.cos()).abs() < 1e-9);
        assert!((pair.gears[0].pitch_radius_mm * 3.0 - pair.centre_distance_mm).abs() < 1e-9);
        // Zero backlash: the two operating pitch circles' thicknesses fill one pitch.
        let thickness: f64 = pair
            .gears
            .iter()
            .map(|gear| 2.0 * gear.pitch_radius_mm * (gear.base_half_angle_rad - (angle.tan() - angle)))
            .sum();
        assert!((thickness - pair.gears[0].pitch_radius_mm * pair.gears[0].pitch_angle_rad()).abs() < 1e-9);
    }

    #[test]
    fn length_of_contact_over_the_base_pitch_is_the_contact_ratio() {
        // The textbook's ε = (√(r_a1² − r_b1²) + √(r_a2² − r_b2²) − a sin α_w)/p_b, at an extended centre
        // distance.
        let mut spec = shen2022_spec();
        spec.geometry.centre_distance_mm = Some(151.5);
        let pair = spec.resolve().unwrap();
        let reach: f64 = pair
            .gears
            .iter()
            .map(|gear| (gear.tip_radius_mm.powi(2) - gear.base_radius_mm.powi(2)).sqrt())
            .sum();
        let length = reach - 151.5 * pair.pressure_angle_rad.sin();
        let base_pitch = pair.gears[0].base_radius_mm * pair.gears[0].pitch_angle_rad();
        assert!((length / base_pitch - pair.contact_ratio()).abs() < 1e-12);
        assert!(pair.contact_ratio() < 1.6114);
    }

    #[test]
    fn masses_and_inertias_are_those_of_solid_discs_unless_given() {
        let mut spec = shen2022_spec();
        let pair = spec.resolve().unwrap();
        // 7850 π 0.072² 0.05 kg and half of that times 0.072².
        assert!((pair.gears[0].mass_kg - 6.392_261).abs() < 1e-6);
        assert!((pair.gears[0].inertia_kg_m2 - 0.016_568_74).abs() < 1e-8);
        spec.dynamics.mass_kg = Some([5.0, 6.0]);
        spec.dynamics.inertia_kg_m2 = Some([0.01, 0.02]);
        let pair = spec.resolve().unwrap();
        assert_eq!((pair.gears[1].mass_kg, pair.gears[0].inertia_kg_m2), (6.0, 0.01));
    }
}
