//! The states of a library as a list, and the flanks at a wear depth.

use axum::Json;
use axum::extract::State;
use serde::{Deserialize, Serialize};

use crate::gear::{Flank, FlankWear, Gear, GearError, PairSpec};
use crate::http::app::App;
use crate::http::libraries;
use crate::http::problem::Problem;
use crate::http::request::query::{NamePath, Page, Parameters};
use crate::library::LibraryState;
use crate::signal::ByName;

/// Number of intervals of the drawn active flank.
const FLANK_STRETCHES: usize = 60;

/// One state in a list: its figures without curves.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct StateRow {
    /// State number, from 0.
    index: usize,
    /// Wear depth in µm, the maximum over the flank.
    wear_um: f64,
    /// Mesh stiffness, mean over the mesh period in N/m.
    stiffness_mean_n_per_m: f64,
    /// Minimum mesh stiffness in N/m.
    stiffness_min_n_per_m: f64,
    /// Maximum mesh stiffness in N/m.
    stiffness_max_n_per_m: f64,
    /// Peak-to-peak transmission error over the mesh period.
    uste_peak_to_peak_rad: f64,
    #[serde(flatten)]
    #[schema(value_type = std::collections::BTreeMap<String, f64>)]
    indicators: ByName<f64>,
}

impl From<&LibraryState> for StateRow {
    fn from(state: &LibraryState) -> Self {
        let stiffness = &state.cycle.stiffness_n_per_m;
        let [least, greatest] = extent(stiffness);
        let [lowest, highest] = extent(&state.cycle.uste_rad);
        Self {
            index: state.index,
            wear_um: state.wear_um,
            stiffness_mean_n_per_m: stiffness.iter().sum::<f64>() / stiffness.len().max(1) as f64,
            stiffness_min_n_per_m: least,
            stiffness_max_n_per_m: greatest,
            uste_peak_to_peak_rad: highest - lowest,
            indicators: state.indicators.values.clone(),
        }
    }
}

fn extent(values: &[f64]) -> [f64; 2] {
    values
        .iter()
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(*value), high.max(*value)])
}

/// List wear states of a library
#[utoipa::path(
    get,
    path = "/v1/libraries/{library}/states",
    tag = "libraries",
    responses((status = 200, body = Page<StateRow>)),
)]
pub(crate) async fn list(
    State(app): State<App>,
    NamePath(id): NamePath,
) -> Result<Json<Page<StateRow>>, Problem> {
    let library = libraries::find(&app, &id).await?;
    let rows = library.states().iter().map(StateRow::from).collect();
    Ok(Json(Page::from_parts(rows, None)))
}

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct FlankParameters {
    /// Wear depth in µm, from 0 to the library's maximum.
    #[param(minimum = 0.0)]
    wear_um: f64,
}

/// Both gears' working flanks at a wear depth.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct FlankView {
    /// Wear depth in µm, the maximum over the flank.
    wear_um: f64,
    /// The driving and the driven gear.
    gears: Vec<FlankRow>,
}

/// One gear's flank from the start of its active profile to the tip, in tooth coordinates: x along the centre
/// line from the gear's centre, y half of the unworn thickness. The depth is along y.
#[derive(Debug, Serialize, utoipa::ToSchema)]
struct FlankRow {
    /// Tooth number.
    teeth: u32,
    /// Root radius in mm.
    root_radius_mm: f64,
    /// Base radius in mm.
    base_radius_mm: f64,
    /// Operating pitch radius in mm.
    pitch_radius_mm: f64,
    /// Tip radius in mm.
    tip_radius_mm: f64,
    /// Radius of each unworn point in mm.
    radius_mm: Vec<f64>,
    /// Its coordinate along the tooth's centre line in mm.
    x_mm: Vec<f64>,
    /// Its distance from the centre line in mm.
    y_mm: Vec<f64>,
    /// Wear depth there in µm.
    depth_um: Vec<f64>,
}

/// Flanks at a wear depth
#[utoipa::path(
    get,
    path = "/v1/libraries/{library}/flank",
    tag = "libraries",
    params(FlankParameters),
    responses((status = 200, body = FlankView)),
)]
pub(crate) async fn flank(
    State(app): State<App>,
    NamePath(id): NamePath,
    Parameters(params): Parameters<FlankParameters>,
) -> Result<Json<FlankView>, Problem> {
    let library = libraries::find(&app, &id).await?;
    let (spec, wear_um) = (library.pair().clone(), params.wear_um);
    let max_um = library.max_wear_um();
    if !(0.0..=max_um).contains(&wear_um) {
        return Err(Problem::query("wear_um", wear_um, &format!("a depth from 0 to {max_um} µm")));
    }
    let _ticket = app.service.workers.admit_response()?;
    let gears = app.service.workers.run("work out flanks", move || flanks(&spec, wear_um)).await?;
    let gears = gears.map_err(|error| {
        Problem::query("wear_um", wear_um, &format!("a depth possible for these teeth: {error}"))
    })?;
    Ok(Json(FlankView { wear_um, gears }))
}

fn flanks(spec: &PairSpec, wear_um: f64) -> Result<Vec<FlankRow>, GearError> {
    let pair = spec.resolve()?;
    let wear = FlankWear::from_shape(&pair, wear_um * 1e-3)?;
    Ok((0..2).map(|index| row(&pair.gears[index], &wear, index)).collect())
}

fn row(gear: &Gear, wear: &FlankWear, index: usize) -> FlankRow {
    let points: Vec<_> = Flank::new(gear, wear, index).active_points(FLANK_STRETCHES).collect();
    FlankRow {
        teeth: gear.teeth,
        root_radius_mm: gear.root_radius_mm,
        base_radius_mm: gear.base_radius_mm,
        pitch_radius_mm: gear.pitch_radius_mm,
        tip_radius_mm: gear.tip_radius_mm,
        radius_mm: points.iter().map(|point| point.radius_mm).collect(),
        x_mm: points.iter().map(|point| point.x_mm).collect(),
        y_mm: points.iter().map(|point| point.y_mm).collect(),
        depth_um: points.iter().map(|point| point.depth_mm * 1e3).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAIR: &str = include_str!("../../../fixtures/pairs/shen2022.toml");

    /// Table 1's tip circle is at module × (teeth/2 + addendum), and the requested wear is the maximum on the
    /// flank.
    #[test]
    fn flanks_end_at_the_tip_and_are_worn_as_deep_as_asked() {
        let rows = flanks(&PairSpec::from_toml(PAIR).unwrap(), 120.0).unwrap();
        for (row, tip_mm) in rows.iter().zip([6.0 * (12.0 + 1.0), 6.0 * (13.0 + 1.0)]) {
            assert!((row.radius_mm.last().unwrap() - tip_mm).abs() < 1e-9);
            let deepest = row.depth_um.iter().copied().fold(0.0, f64::max);
            assert!((deepest - 120.0).abs() < 1e-6, "{deepest}");
        }
    }
}
