use super::{ArchardWear, Course, Goal};
use crate::gear::contact_load::arc_mm;
use crate::gear::testing::shen2022_spec;
use crate::gear::{ContactRule, Flank, FlankWear, GearError, GearPair, WearShape};

fn pair(rule: ContactRule) -> GearPair {
    let mut spec = shen2022_spec();
    spec.dynamics.contact = rule;
    spec.resolve().unwrap()
}

/// Depths in mm of a gear at 32 even steps of α₁ from start of active profile to tip.
fn depths(pair: &GearPair, wear: &FlankWear, i: usize) -> Vec<f64> {
    Flank::new(&pair.gears[i], wear, i)
        .active_points(32)
        .map(|point| point.depth_mm)
        .collect()
}

/// Fig. 6: from tip to root the depth falls to the pitch point and rises again, more than it fell.
#[test]
fn shape_is_that_of_figure_6() {
    for rule in [ContactRule::Threshold, ContactRule::Loaded] {
        let pair = pair(rule);
        let state = &ArchardWear::at_depths(&pair, &[0.012]).unwrap()[0];
        assert!((state.wear.greatest_depth_mm(&pair).into_iter().fold(0.0, f64::max) - 0.012).abs() < 1e-4);
        for (i, gear) in pair.gears.iter().enumerate() {
            let flank = Flank::new(gear, &state.wear, i);
            let pitch = flank.alpha_at_radius_rad(gear.pitch_radius_mm);
            let near = flank.at(pitch).depth_mm;
            let all = depths(&pair, &state.wear, i);
            let greatest = |part: &[f64]| part.iter().copied().fold(0.0, f64::max);
            let at = all
                .iter()
                .position(|depth| *depth == all.iter().copied().fold(f64::INFINITY, f64::min))
                .unwrap();
            // The last 2a before the tip apart: there elastic teeth touch with the tip's edge, which digs in.
            let (root, tip) = (greatest(&all[..at]), greatest(&all[at..31]));
            println!("{rule}, gear {}: root {root:.5}, pitch {near:.5}, tip {tip:.5} mm", i + 1);
            assert!(near < 0.1 * root && near < 0.25 * tip && root > 1.3 * tip, "{rule} {all:?}");
            // Between its greatest values on both sides the depth has its one minimum at the pitch point.
            let place = gear.root_angle_rad + (gear.tip_angle_rad - gear.root_angle_rad) * at as f64 / 32.0;
            assert!((place - pitch).abs() < 0.02, "{rule} {place} {pitch}");
            let from = all.iter().position(|depth| *depth == root).unwrap();
            assert!(all[from..=at].windows(2).all(|two| two[1] < two[0] + 1e-4), "{rule} {all:?}");
        }
    }
}

/// Flodin and Andersson: a point loses k · p̄ · 2a |1 − u_j/u_i| in each mesh, p̄ = F/(2a) under Hertz's band.
#[test]
fn one_point_is_the_closed_form() {
    let pair = pair(ContactRule::Threshold);
    let course = Course::new(&pair, 1e-3).unwrap();
    let rates = course.rates().unwrap();
    let turns = 1000.0;
    // Single contact lies between α₁ = a₁ − 2π/z₁ = 0.2315 and c₁ + 2π/z₁ = 0.3332, the pitch point at 0.2837: all of the force.
    let angle = 0.31;
    for i in 0..2 {
        let cells = &course.flanks[i];
        // Perfect flanks: α₁ = φ₁ + α₀, α₁′ with R_b1 (α₁ + α₂) + R_b2 (α₁′ + α₂′) = a sin α₀.
        let lengths = |driving: f64| {
            let first = pair.gears[0].base_radius_mm * (driving + pair.gears[0].base_half_angle_rad);
            [first, pair.centre_distance_mm * pair.pressure_angle_rad.sin() - first]
        };
        let length = lengths(angle);
        let gear = &pair.gears[i];
        let alpha = length[i] / gear.base_radius_mm - gear.base_half_angle_rad;
        let force = 1300.0 / (pair.gears[0].base_radius_mm * 1e-3) / 0.05;
        let half_width = 0.2359e-3;
        let pressure = force / (2.0 * half_width);
        let ratio = pair.gears[0].base_radius_mm / pair.gears[1].base_radius_mm;
        let rolling = [length[0], length[1] * ratio];
        let sliding = 2.0 * half_width * (1.0 - rolling[1 - i] / rolling[i]).abs();
        let meshes = turns * [1.0, 24.0 / 26.0][i];
        let wanted_mm = 3.5e-6 / 7e9 * pressure * sliding * meshes / alpha.cos() * 1e3;
        let place = (arc_mm(gear, alpha) - cells.arcs_mm[0]) / cells.cell_mm;
        let (before, part) = (place as usize, place.fract());
        let found = turns * (rates[i][before] + part * (rates[i][before + 1] - rates[i][before]));
        println!("gear {}: {found:.6e} mm, closed form {wanted_mm:.6e}", i + 1);
        assert!((found / wanted_mm - 1.0).abs() < 0.02);
    }
}

/// Eq. (22): V = K W s/H is the same for both gears of equal hardness, so each tooth's share goes by the other gear's tooth number.
#[test]
fn both_gears_lose_the_same_volume_and_the_softer_one_more() {
    let volumes = |hardness_pa: [f64; 2]| {
        let mut spec = shen2022_spec();
        spec.wear.hardness_pa = hardness_pa;
        let pair = spec.resolve().unwrap();
        let course = Course::new(&pair, 1e-3).unwrap();
        let loads = crate::gear::contact_load::contact_loads(&pair, &FlankWear::none(), None).unwrap();
        [0, 1].map(|i| {
            let rates = course.flanks[i].normal_rates(&loads, i);
            let inner: f64 = rates[1..rates.len() - 1].iter().sum();
            (inner + 0.5 * (rates[0] + rates[rates.len() - 1])) * course.flanks[i].cell_mm
        })
    };
    let equal = volumes([7e9, 7e9]);
    assert!((equal[0] * 24.0 / (equal[1] * 26.0) - 1.0).abs() < 1e-9, "{equal:?}");
    let softer = volumes([7e9, 3.5e9]);
    assert!((softer[1] / equal[1] - 2.0).abs() < 1e-9 && (softer[0] / equal[0] - 1.0).abs() < 1e-9);
}

/// Few turns take off in proportion; K shifts the turns and not the shape.
#[test]
fn depth_is_proportional_to_turns_at_first_and_to_the_coefficient() {
    let mut spec = shen2022_spec();
    let pair = spec.resolve().unwrap();
    let depth = |pair: &GearPair, turns: f64| depths(pair, &ArchardWear::after_turns(pair, turns).unwrap().wear, 0);
    let (once, twice) = (depth(&pair, 500.0), depth(&pair, 1000.0));
    for (a, b) in once.iter().zip(&twice) {
        assert!((b - 2.0 * a).abs() < 1e-12, "{a} {b}");
    }
    spec.wear.coefficient *= 2.0;
    let faster = depth(&spec.resolve().unwrap(), 500.0);
    assert!(faster.iter().zip(&twice).all(|(a, b)| (a - b).abs() < 1e-12));
    assert_eq!(ArchardWear::after_turns(&pair, 0.0).unwrap().wear, FlankWear::none());
}

/// Halving the step of the course changes the shape little where the threshold rule lets pairs take turns.
#[test]
fn course_has_settled_in_its_step() {
    let pair = pair(ContactRule::Threshold);
    let with = |step_mm: f64| {
        let mut course = Course::new(&pair, step_mm).unwrap();
        course.until(Goal::Depth(0.012)).unwrap();
        depths(&pair, &course.wear(), 0)
    };
    let (used, halved) = (with(super::STEP_MM), with(0.5 * super::STEP_MM));
    let worst = used.iter().zip(&halved).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    println!("greatest change {:.3} µm of 12 µm", worst * 1e3);
    assert!(worst < 1.2e-3);
}

#[test]
fn the_shape_of_a_pair_file_reaches_its_depth_state_by_state() {
    let mut spec = shen2022_spec();
    spec.wear.shape = WearShape::Archard;
    let pair = spec.resolve().unwrap();
    let states = FlankWear::from_shape_at(&pair, &[0.0, 0.002, 0.004]).unwrap();
    assert_eq!(states[0], FlankWear::none());
    assert_eq!(states[2], FlankWear::from_shape_at(&pair, &[0.002, 0.004]).unwrap()[1]);
    assert!(matches!(
        FlankWear::from_shape_at(&pair, &[0.004, 0.002]),
        Err(GearError::Field {
            field: "wear depth in mm",
            ..
        })
    ));
    let text = toml::to_string(&spec).unwrap();
    assert!(text.contains("shape = \"archard\""));
    assert_eq!(crate::gear::PairSpec::from_toml(&text).unwrap(), spec);
}
