//! Loaded contact seen from the other side: with the gears' places changed and the motion mirrored, the same
//! teeth touch in the same positions. The model looks for touches on the driving flank in another way than on
//! the driven one, so this is a check of both.

use std::f64::consts::PI;

use super::testing::shen2022_spec;
use super::{ContactRule, FlankWear, MeshCycle, PairSpec};

/// Radius in mm and depth in µm of points of gear 1 and gear 2.
type Tables = [Vec<(f64, f64)>; 2];

fn cycle(spec: &PairSpec, tables: [&[(f64, f64)]; 2]) -> (MeshCycle, f64, f64) {
    let pair = spec.resolve().unwrap();
    let rows: String = (0..2)
        .flat_map(|i| tables[i].iter().map(move |(radius, depth)| format!("{},{radius},{depth}\n", i + 1)))
        .collect();
    let wear = FlankWear::from_table_csv(&pair, &format!("gear,radius_mm,depth_um\n{rows}")).unwrap();
    let cycle = MeshCycle::compute(&pair, &wear, 1000).unwrap();
    (cycle, pair.gears[0].base_radius_mm, pair.gears[1].base_radius_mm)
}

/// A column of the cycle at a place in mesh periods from its first point, linearly between points.
fn at(column: &[f64], place: f64) -> f64 {
    let place = place.rem_euclid(1.0) * column.len() as f64;
    let (before, part) = (place as usize % column.len(), place.fract());
    column[before] + part * (column[(before + 1) % column.len()] - column[before])
}

/// Greatest difference of the stiffness over the mesh period.
fn difference(torque_nm: f64, tables: &Tables) -> f64 {
    let mut spec = shen2022_spec();
    spec.dynamics.contact = ContactRule::Loaded;
    (spec.operation.torque_nm, spec.operation.output_torque_nm) = (torque_nm, None);
    let (seen, base, other_base) = cycle(&spec, [&tables[0], &tables[1]]);
    spec.geometry.teeth = [26, 24];
    spec.operation.torque_nm = torque_nm * 26.0 / 24.0;
    let (mirrored, ..) = cycle(&spec, [&tables[1], &tables[0]]);
    (0..1000)
        .map(|i| {
            // φ₁ of the middle of a driving tooth at the pitch point is −π/(2z).
            let phi1 = seen.phi1_rad[i];
            let rolled = base * (phi1 + PI / 48.0) - other_base * seen.uste_rad[i];
            let mirrored_phi1 = -PI / 52.0 - rolled / other_base;
            let wanted =
                at(&mirrored.stiffness_n_per_m, (mirrored_phi1 - mirrored.phi1_rad[0]) * 26.0 / (2.0 * PI));
            (seen.stiffness_n_per_m[i] / wanted - 1.0).abs()
        })
        .fold(0.0, f64::max)
}

/// The parabolic shape of the default with the greatest depth `h_um` on one gear of the typical pair.
fn parabola(gear: usize, h_um: f64) -> Vec<(f64, f64)> {
    let pair = shen2022_spec().resolve().unwrap();
    let gear = &pair.gears[gear];
    let (sap, pitch, tip) = (gear.sap_radius_mm, gear.pitch_radius_mm, gear.tip_radius_mm);
    (0..=60)
        .map(|i| {
            let radius = sap + (tip - sap) * f64::from(i) / 60.0;
            let (side, top) = if radius < pitch { (pitch - sap, 1.0) } else { (tip - pitch, 0.7) };
            (radius, h_um * (0.05 + (top - 0.05) * ((radius - pitch) / side).powi(4)))
        })
        .collect()
}

/// The arms of worn flanks differ by up to 1 % a gear from the base radii that the stiffness is referred to,
/// and θ from the infinitesimal one.
#[test]
fn stiffness_is_the_same_from_both_sides() {
    let none = || vec![(72.0, 0.0)];
    let cases: [(&str, Tables); 5] = [
        ("no wear", [none(), none()]),
        ("200 µm", [parabola(0, 200.0), parabola(1, 200.0)]),
        ("200 µm on gear 1 alone", [parabola(0, 200.0), none()]),
        ("200 µm on gear 2 alone", [none(), parabola(1, 200.0)]),
        ("a hollow 3 mm wide", [none(), vec![(78.5, 0.0), (79.1, 60.0), (80.9, 60.0), (81.5, 0.0)]]),
    ];
    for (name, tables) in cases {
        for torque_nm in [130.0, 1300.0] {
            let worst = difference(torque_nm, &tables);
            println!("{name}, {torque_nm} N·m: {:.2} %", 100.0 * worst);
            assert!(worst < 0.05, "{name}, {torque_nm} N·m: {worst}");
        }
    }
}
