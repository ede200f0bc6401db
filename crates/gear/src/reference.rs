//! The model against `fixtures/reference/shen2022.toml`.

use serde::Deserialize;

use super::testing::{shen2022, typical_wear};
use super::{FlankWear, Gear, MeshCycle, MeshRelationship};

#[derive(Deserialize)]
struct Reference {
    number: Vec<Number>,
}

#[derive(Deserialize)]
struct Number {
    name: String,
    value: Vec<f64>,
    tolerance: f64,
    source: String,
}

/// What the model gives for a name of the file.
fn given(name: &str) -> Vec<f64> {
    let pair = shen2022();
    let of_both = |value: fn(&Gear) -> f64| pair.gears.iter().map(value).collect();
    match name {
        "base_radius_mm" => of_both(|gear| gear.base_radius_mm),
        "root_radius_mm" => of_both(|gear| gear.root_radius_mm),
        "tip_radius_mm" => of_both(|gear| gear.tip_radius_mm),
        "base_half_angle_rad" => of_both(|gear| gear.base_half_angle_rad),
        "root_angle_rad" => of_both(|gear| gear.root_angle_rad),
        "tip_angle_rad" => of_both(|gear| gear.tip_angle_rad),
        "centre_distance_mm" => vec![pair.centre_distance_mm],
        "contact_ratio" => vec![pair.contact_ratio()],
        "start_of_contact_rad" => vec![pair.start_of_contact_rad()],
        "worn_alpha1_range_rad" => vec![range(&worn().alpha1_rad)],
        "worn_phi1_range_rad" => vec![range(&worn().phi1_rad)],
        "stiffness_error_double_contact" => vec![stiffness_error_at(-0.1976)],
        "stiffness_error_single_contact" => vec![stiffness_error_at(-0.0667)],
        "stiffness_error_hand_over" => {
            vec![stiffness_errors().iter().map(|point| point.1).fold(0.0, f64::min)]
        }
        _ => panic!("{name:?} is no number of the model"),
    }
}

fn worn() -> MeshRelationship {
    let (pair, wear) = typical_wear();
    MeshRelationship::solve(&pair, &wear).unwrap()
}

fn range(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
        - values.iter().copied().fold(f64::INFINITY, f64::min)
}

/// φ₁ and k/K_FE − 1 at the points of the finite-element table.
fn stiffness_errors() -> Vec<(f64, f64)> {
    let table = include_str!("../../../fixtures/reference/mesh-stiffness-fe/K_perfect.csv");
    let cycle = MeshCycle::compute(&shen2022(), &FlankWear::none(), 9600).unwrap();
    let (start, step) = (cycle.phi1_rad[0], cycle.phi1_rad[1] - cycle.phi1_rad[0]);
    let mut rows = csv::Reader::from_reader(table.as_bytes());
    let rows = rows.records().map(|row| row.unwrap());
    rows.map(|row| {
        let (phi1, stiffness): (f64, f64) = (row[0].parse().unwrap(), row[1].parse().unwrap());
        let place = ((phi1 - start) / step).round() as usize % 9600;
        (phi1, cycle.stiffness_n_per_m[place] / stiffness - 1.0)
    })
    .collect()
}

fn stiffness_error_at(phi1: f64) -> f64 {
    let errors = stiffness_errors();
    let nearest = errors.iter().min_by(|a, b| (a.0 - phi1).abs().total_cmp(&(b.0 - phi1).abs()));
    nearest.unwrap().1
}

#[test]
fn the_model_gives_every_reference_number() {
    let reference: Reference =
        toml::from_str(include_str!("../../../fixtures/reference/shen2022.toml")).unwrap();
    assert_eq!(reference.number.len(), 17);
    for Number { name, value, tolerance, source } in reference.number {
        let given = given(&name);
        assert_eq!(given.len(), value.len(), "{name}");
        for (given, wanted) in given.iter().zip(value) {
            assert!((given - wanted).abs() <= tolerance, "{name}: {given}, expected {wanted} ({source})");
        }
    }
}
