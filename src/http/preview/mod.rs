//! `/v1/preview`: the model's predictions for a gear pair, without an asset or a record.

mod geometry;
pub(super) mod model;
mod refusal;
mod vibration;

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use serde::{Deserialize, Serialize};

use super::app::App;
use super::problem::Problem;
use super::request::body;
use crate::asset::{AssetError, GearSpec};
use geometry::GeometryView;
use model::{Conditions, ModelView};
use refusal::Refusal;

/// A preview request.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[schema(as = PreviewRequest)]
#[serde(deny_unknown_fields)]
pub(super) struct Request {
    /// The mesh as in an asset's description.
    gear: GearSpec,
    /// Maximum wear depth in µm, from 0 to the response's `max_wear_um`.
    #[serde(default)]
    wear_um: f64,
    /// Torque on the driving gear in N·m; by default the pair's.
    #[serde(default)]
    torque_nm: Option<f64>,
    /// Rotational frequency of the driving shaft in hertz; by default the pair's.
    #[serde(default)]
    shaft_speed_hz: Option<f64>,
}

/// The model's predictions for a gear pair.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Preview {
    /// All reasons for which `POST /v1/assets` would refuse these teeth, this speed and this pair, and
    /// impossible wear or operating points; empty if everything is valid.
    refusals: Vec<Refusal>,
    /// Geometry of the pair, even of an impossible one; none without a pair or if its numbers define no
    /// geometry.
    #[serde(skip_serializing_if = "Option::is_none")]
    geometry: Option<GeometryView>,
    /// Maximum wear depth in µm that can be previewed.
    #[serde(skip_serializing_if = "Option::is_none")]
    max_wear_um: Option<f64>,
    /// Mesh and vibration, unworn and worn; none if something is refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    model: Option<ModelView>,
}

/// Preview a gear pair
///
/// The model's predictions for a described pair, without an asset or a library: geometry with its limits, and
/// at a wear depth, torque and speed the flanks, mesh stiffness, transmission error and expected vibration.
/// For an impossible pair, the response lists all errors and any geometry that can be computed. The mesh uses
/// the coarse resolution (the first ten mesh harmonics are within 1 % of a library's) and the compliance of
/// the unworn teeth; the vibration covers at most 256 mesh periods. Archard wear uses steps of 1/24 of the
/// maximum depth.
#[utoipa::path(
    post,
    path = "/v1/preview",
    tag = "libraries",
    request_body(content = Request, description = "The mesh, its wear and its operating point"),
    responses((status = 200, body = Preview)),
)]
pub(super) async fn preview(
    State(app): State<App>,
    headers: HeaderMap,
    body: Body,
) -> Result<Json<Preview>, Problem> {
    let _ticket = app.service.workers.admit_response()?;
    let request: Request = body::json_body(&app.limits, &headers, body).await?;
    let models = app.previews.clone();
    let response = app.service.workers.run("preview a gear pair", move || {
        let mut refusals = refusals_beside_pair(&request.gear);
        let Some(pair) = &request.gear.pair else {
            return Preview { refusals, geometry: None, max_wear_um: None, model: None };
        };
        let assessment = pair.assess();
        refusals.extend(assessment.refusals.iter().map(Refusal::of_pair));
        let mut conditions = Conditions {
            wear_um: request.wear_um,
            torque_nm: request.torque_nm.unwrap_or(pair.operation.torque_nm),
            shaft_speed_hz: request.shaft_speed_hz.unwrap_or(pair.operation.shaft_speed_hz),
        };
        // The maximum depth of a preview is that of a library's grid.
        let max_wear_um = pair.usual_wear_um();
        if !(0.0..=max_wear_um).contains(&conditions.wear_um) && assessment.pair.is_some() {
            refusals.push(Refusal::of_field(
                "wear_um",
                conditions.wear_um,
                format!("a depth from 0 to {max_wear_um:.1}"),
            ));
            conditions.wear_um = 0.0;
        }
        let model = if refusals.is_empty() {
            models.view(pair, &conditions).map_err(|refusal| refusals.push(refusal)).ok()
        } else {
            None
        };
        Preview {
            refusals,
            max_wear_um: assessment.pair.is_some().then_some(max_wear_um),
            geometry: assessment.pair.and_then(|drafted| GeometryView::of(&drafted, assessment.measures)),
            model,
        }
    });
    Ok(Json(response.await?))
}

/// Reasons to refuse an asset with this mesh, besides the pair's own numbers.
fn refusals_beside_pair(gear: &GearSpec) -> Vec<Refusal> {
    let refusal = |error| match error {
        AssetError::Field { field, value, expected } => Refusal::of_field(field, value, expected),
        other => Refusal::in_words(&other),
    };
    [gear.check_beside_pair(), gear.check_pair_teeth()]
        .into_iter()
        .filter_map(|checked| checked.err().map(refusal))
        .collect()
}
