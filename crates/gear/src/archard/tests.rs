use super::{ArchardWear, STEP_MODULES, Target, WearHistory};
use crate::contact_band::arc_mm;
use crate::testing::shen2022_spec;
use crate::{ContactRule, Flank, FlankWear, GearError, GearPair, WearShape};

/// K.
const COEFFICIENT: f64 = 3.5e-6;

fn pair(rule: ContactRule) -> GearPair {
    let mut spec = shen2022_spec();
    spec.dynamics.contact = rule;
    // What the second method of `fixtures/reference/archard` was run with.
    spec.wear.coefficient = COEFFICIENT;
    spec.resolve().unwrap()
}

/// Depths in mm of a gear at 32 even steps of α₁ from start of active profile to tip.
fn depths(pair: &GearPair, wear: &FlankWear, i: usize) -> Vec<f64> {
    Flank::new(&pair.gears[i], wear, i).active_points(32).map(|point| point.depth_mm).collect()
}

/// Fig. 6: from tip to root the depth falls to the pitch point and rises again, more than it fell.
#[test]
fn shape_is_that_of_figure_6() {
    for rule in [ContactRule::Threshold, ContactRule::Loaded] {
        let pair = pair(rule);
        let state = &ArchardWear::at_depths(&pair, &[0.012], STEP_MODULES).unwrap()[0];
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

/// Flodin and Andersson: a point loses k · p̄ · 2a |1 − u_j/u_i| in each mesh, p̄ = F/(2a) under Hertz's
/// band.
#[test]
fn one_point_is_the_closed_form() {
    let pair = pair(ContactRule::Threshold);
    let history = WearHistory::new(&pair, 1e-3 / 6.0).unwrap();
    let rates = history.rates().unwrap();
    let turns = 1000.0;
    // Single contact lies between α₁ = a₁ − 2π/z₁ = 0.2315 and c₁ + 2π/z₁ = 0.3332, the pitch point at
    // 0.2837: all of the force.
    let angle = 0.31;
    for i in 0..2 {
        let cells = &history.flanks[i];
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
        let wanted_mm = COEFFICIENT / 7e9 * pressure * sliding * meshes / alpha.cos() * 1e3;
        let place = (arc_mm(gear, alpha) - cells.arcs_mm[0]) / cells.cell_mm;
        let (before, part) = (place as usize, place.fract());
        let found = turns * (rates[i][before] + part * (rates[i][before + 1] - rates[i][before]));
        println!("gear {}: {found:.6e} mm, closed form {wanted_mm:.6e}", i + 1);
        assert!((found / wanted_mm - 1.0).abs() < 0.02);
    }
}

/// Eq. (22): V = K W s/H is the same for both gears of equal hardness, so each tooth's share goes by the
/// other gear's tooth number.
#[test]
fn both_gears_lose_the_same_volume_and_the_softer_one_more() {
    let volumes = |hardness_pa: [f64; 2]| {
        let mut spec = shen2022_spec();
        spec.wear.hardness_pa = hardness_pa;
        let pair = spec.resolve().unwrap();
        let history = WearHistory::new(&pair, 1e-3 / 6.0).unwrap();
        let rubbings = history.rubbings(&FlankWear::none()).unwrap();
        [0, 1].map(|i| {
            let rates = history.flanks[i].normal_rates(&rubbings, i);
            let inner: f64 = rates[1..rates.len() - 1].iter().sum();
            (inner + 0.5 * (rates[0] + rates[rates.len() - 1])) * history.flanks[i].cell_mm
        })
    };
    let equal = volumes([7e9, 7e9]);
    // What the bands take off below the starts of the active profiles is not followed: 3 % of a tooth's, and
    // not the same on both gears.
    assert!((equal[0] * 24.0 / (equal[1] * 26.0) - 1.0).abs() < 0.012, "{equal:?}");
    let softer = volumes([7e9, 3.5e9]);
    assert!((softer[1] / equal[1] - 2.0).abs() < 1e-9 && (softer[0] / equal[0] - 1.0).abs() < 1e-9);
}

/// `fixtures/reference/archard`: pressures of elastic half-planes on the line of action, with a load sharing
/// of its own. The pitch point, which carries alone in both, agrees within 8 %; elsewhere the sharing differs
/// by what elastic bodies and tip edges do.
#[test]
fn history_equals_that_of_a_second_method() {
    const STATES_MM: [f64; 5] = [0.012, 0.025, 0.05, 0.1, 0.245];
    let pair = pair(ContactRule::Loaded);
    let states = ArchardWear::at_depths(&pair, &STATES_MM, STEP_MODULES).unwrap();
    let mut greatest = [(0.0_f64, 0.0_f64); 2];
    for line in include_str!("../../../../fixtures/reference/archard/wear.csv").lines().skip(1) {
        let numbers: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        let &[greatest_um, turns, gear, alpha, wanted_um] = numbers.as_slice() else {
            panic!("five numbers")
        };
        let place = STATES_MM.iter().position(|depth| (depth * 1e3 - greatest_um).abs() < 0.01).unwrap();
        let (state, i) = (&states[place], gear as usize - 1);
        assert!(
            (state.driving_turns / turns - 1.0).abs() < 0.15,
            "{greatest_um} µm: {} turns, {turns}",
            state.driving_turns
        );
        let gear = &pair.gears[i];
        let part = (alpha - gear.root_angle_rad) / (gear.tip_angle_rad - gear.root_angle_rad);
        let found_um = Flank::new(gear, &state.wear, i).at(alpha).depth_mm * 1e3;
        let error = (found_um - wanted_um).abs() / greatest_um;
        let (inside, outside) = &mut greatest[usize::from(greatest_um < 40.0)];
        if (0.4..0.6).contains(&part) {
            *inside = inside.max(error);
        } else if (0.12..0.85).contains(&part) {
            *outside = outside.max(error);
        }
    }
    println!(
        "of the greatest depth, around the pitch point and elsewhere: deep {:?}, light {:?}",
        greatest[0], greatest[1]
    );
    assert!(greatest[0].0 < 0.06 && greatest[0].1 < 0.06, "{greatest:?}");
    assert!(greatest[1].0 < 0.06 && greatest[1].1 < 0.12, "{greatest:?}");
}

/// The flanks near the pitch point are worn because the contact lingers on what stands proud there: almost
/// nothing up to 25 µm, more than half of the greatest depth at 245 µm. The least depth stays near the pitch
/// point, and the profile stays smooth.
#[test]
fn the_pitch_point_is_spared_by_light_wear_only() {
    for rule in [ContactRule::Threshold, ContactRule::Loaded] {
        let pair = pair(rule);
        let states = ArchardWear::at_depths(&pair, &[0.012, 0.025, 0.1, 0.245], STEP_MODULES).unwrap();
        for (state, limits) in states.iter().zip([(0.0, 0.05), (0.05, 0.1), (0.3, 0.4), (0.5, 0.65)]) {
            let deepest = state.wear.greatest_depth_mm(&pair).into_iter().fold(0.0, f64::max);
            for (i, gear) in pair.gears.iter().enumerate() {
                let flank = Flank::new(gear, &state.wear, i);
                let part = flank.at(flank.alpha_at_radius_rad(gear.pitch_radius_mm)).depth_mm / deepest;
                println!("{rule}, {deepest:.3} mm, gear {}: {part:.3}", i + 1);
                assert!(part > limits.0 && part < limits.1, "{rule}, {deepest} mm, gear {}: {part}", i + 1);
                // From its greatest value at the root side the depth falls to one minimum near the pitch
                // point, then rises.
                let all = depths(&pair, &state.wear, i);
                let middle = (8..22).min_by(|a, b| all[*a].total_cmp(&all[*b])).unwrap();
                assert!((15..=18).contains(&middle), "{rule} {middle} {all:?}");
                let slack = 0.005 * deepest;
                assert!(all[6..=middle].windows(2).all(|two| two[1] < two[0] + slack), "{rule} {all:?}");
                assert!(all[middle..=22].windows(2).all(|two| two[1] > two[0] - slack), "{rule} {all:?}");
            }
        }
    }
}

/// Few turns take off in proportion; K shifts the turns and not the shape.
#[test]
fn depth_is_proportional_to_turns_at_first_and_to_the_coefficient() {
    let mut spec = shen2022_spec();
    let pair = spec.resolve().unwrap();
    let depth =
        |pair: &GearPair, turns: f64| depths(pair, &ArchardWear::after_turns(pair, turns).unwrap().wear, 0);
    let (once, twice) = (depth(&pair, 500.0), depth(&pair, 1000.0));
    for (a, b) in once.iter().zip(&twice) {
        assert!((b - 2.0 * a).abs() < 1e-12, "{a} {b}");
    }
    spec.wear.coefficient *= 2.0;
    let faster = depth(&spec.resolve().unwrap(), 500.0);
    assert!(faster.iter().zip(&twice).all(|(a, b)| (a - b).abs() < 1e-12));
    assert_eq!(ArchardWear::after_turns(&pair, 0.0).unwrap().wear, FlankWear::none());
}

/// Halving the step of the history changes the shape little where the threshold rule lets pairs take turns.
#[test]
fn history_has_converged_in_its_step() {
    let pair = pair(ContactRule::Threshold);
    let with = |step_modules: f64| {
        let mut history = WearHistory::new(&pair, step_modules).unwrap();
        history.advance_to(Target::Depth(0.012)).unwrap();
        depths(&pair, &history.wear(), 0)
    };
    let (used, halved) = (with(super::STEP_MODULES), with(0.5 * super::STEP_MODULES));
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
    assert_eq!(states[0].profiles, FlankWear::none().profiles);
    assert_eq!(states[0].driving_turns(), Some(0.0));
    let turns = ArchardWear::at_depths(&pair, &[0.004], STEP_MODULES).unwrap()[0].driving_turns;
    assert!((states[2].driving_turns().unwrap() / turns - 1.0).abs() < 0.02);
    assert_eq!(
        FlankWear::from_table_csv(&pair, "gear,radius_mm,depth_um\n1,70,5\n").unwrap().driving_turns(),
        None
    );
    assert_eq!(states[2], FlankWear::from_shape_at(&pair, &[0.002, 0.004]).unwrap()[1]);
    assert!(matches!(
        FlankWear::from_shape_at(&pair, &[0.004, 0.002]),
        Err(GearError::Field { field: "wear depth in mm", .. })
    ));
    let text = toml::to_string(&spec).unwrap();
    assert!(text.contains("shape = \"archard\""));
    assert_eq!(crate::PairSpec::from_toml(&text).unwrap(), spec);
}
