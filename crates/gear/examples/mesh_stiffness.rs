//! Mesh stiffness and transmission error of a gear pair over one mesh period, unworn and worn.
//!
//! `cargo run -p flankwatch-gear --example mesh_stiffness [PAIR.toml [WEAR_MM]]`

use std::error::Error;

use flankwatch_gear::{FlankWear, MeshCycle, PairSpec};

/// Defaults not stated here: steel, standard full-depth teeth, and contact by the paper's threshold rule.
const PAIR: &str = r#"
    [geometry]
    teeth = [24, 26]              # driving, driven
    module_mm = 6.0
    face_width_mm = 50.0
    bore_radius_mm = [20.0, 20.0]
    centre_distance_mm = 150.0

    [operation]
    torque_nm = 1300.0
    shaft_speed_hz = 16.64
"#;

/// Positions in one mesh period.
const POINTS: usize = 16;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let text = arguments.next().map_or_else(|| Ok(PAIR.to_owned()), std::fs::read_to_string)?;
    let depth_mm = arguments.next().map_or(Ok(0.15), |depth| depth.parse())?;
    let pair = PairSpec::from_toml(&text)?.resolve()?;
    let unworn = MeshCycle::compute(&pair, &FlankWear::none(), POINTS)?;
    let worn = MeshCycle::compute(&pair, &FlankWear::from_shape(&pair, depth_mm)?, POINTS)?;
    println!("contact ratio {:.3}; worn by {depth_mm} mm at the deepest place\n", pair.contact_ratio());
    println!("             stiffness in N/µm    pairs in contact   transmission");
    println!("  φ₁ in °    unworn      worn    unworn    worn   error in µrad");
    for i in 0..POINTS {
        println!(
            "{:9.3} {:9.1} {:9.1} {:9} {:7} {:15.1}",
            worn.phi1_rad[i].to_degrees(),
            1e-6 * unworn.stiffness_n_per_m[i],
            1e-6 * worn.stiffness_n_per_m[i],
            unworn.pairs_in_contact[i],
            worn.pairs_in_contact[i],
            1e6 * worn.uste_rad[i],
        );
    }
    println!(
        "\nmean stiffness {:.1} N/µm unworn, {:.1} N/µm worn",
        1e-6 * unworn.mean_stiffness_n_per_m(),
        1e-6 * worn.mean_stiffness_n_per_m()
    );
    Ok(())
}
