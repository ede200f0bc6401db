//! A synthetic library for unit tests: curves of known shape, some not monotonic, without a gear model.

use super::operating::state_curves;
use super::{CycleTable, GridSettings, Library, LibraryState, Manifest};
use flankwatch_gear::{GeometrySpec, OperationSpec, PairSpec};
use flankwatch_signal::{ByName, Features, Indicators};

type Curve = fn(f64) -> f64;

/// Natural logarithms of four mesh lines over wear in parts of the greatest; the second falls and then rises.
const CURVES: [(&str, Curve); 4] = [
    ("ln_mesh_1", |w| 1.2 * w),
    ("ln_mesh_2", |w| 2.0 * (w - 0.4) * (w - 0.4)),
    ("ln_mesh_3", |w| 1.5 * (1.0 + 3.0 * w).ln()),
    ("ln_mesh_4", |w| (4.0 * w).sin()),
];

/// 50 states from 0 to 245 µm.
pub(crate) fn synthetic_library() -> Library {
    let grid = GridSettings::default();
    let states: Vec<LibraryState> = (0..grid.states)
        .map(|index| {
            let wear_um = grid.wear_um(index);
            let values =
                CURVES.iter().map(|(name, curve)| (*name, curve(wear_um / grid.max_wear_um))).collect();
            let indicators =
                Indicators { values: ByName::from([("rms", 1.0 + wear_um)]), absent: ByName::default() };
            LibraryState {
                index,
                wear_um,
                driving_turns: None,
                indicators,
                features: Features { values, ..Features::default() },
                cycle: CycleTable::default(),
            }
        })
        .collect();
    let manifest = Manifest {
        id: "0123456789abcdef".to_owned(),
        model_version: "synthetic".to_owned(),
        preprocessing: "synthetic".to_owned(),
        pair: synthetic_pair(),
        grid,
    };
    let tables = vec![state_curves(&states)];
    Library::from_parts(manifest, states, tables)
}

fn synthetic_pair() -> PairSpec {
    PairSpec {
        name: "synthetic".to_owned(),
        geometry: GeometrySpec {
            teeth: [24, 26],
            module_mm: 6.0,
            face_width_mm: 50.0,
            pressure_angle_deg: 20.0,
            addendum: [1.0; 2],
            dedendum: [1.25; 2],
            bore_radius_mm: Some([20.0; 2]),
            profile_shift: [0.0; 2],
            centre_distance_mm: Some(150.0),
        },
        material: Default::default(),
        operation: OperationSpec { torque_nm: 1300.0, output_torque_nm: None, shaft_speed_hz: 16.64 },
        supports: Default::default(),
        dynamics: Default::default(),
        errors: Default::default(),
        wear: Default::default(),
    }
}
