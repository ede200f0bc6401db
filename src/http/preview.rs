//! `/v1/preview`: what a described gear pair does, before there is an asset or a record.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use serde::{Deserialize, Serialize};

use super::app::App;
use super::body;
use super::preview_geometry::GeometryView;
use super::preview_model::{Conditions, ModelView};
use super::preview_refusal::Refusal;
use super::problem::Problem;
use crate::asset::{AssetError, GearSpec};
use crate::gear::PairSpec;

/// What is to be previewed.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[schema(as = PreviewRequest)]
#[serde(deny_unknown_fields)]
pub(super) struct Request {
    /// The mesh as an asset describes it.
    gear: GearSpec,
    /// Greatest wear depth in µm, from 0 to the answer's `max_wear_um`.
    #[serde(default)]
    wear_um: f64,
    /// Torque on the driving gear in N·m; that of the pair where not given.
    #[serde(default)]
    torque_nm: Option<f64>,
    /// Rotational frequency of the driving shaft in hertz; that of the pair where not given.
    #[serde(default)]
    shaft_speed_hz: Option<f64>,
}

/// What the model says of a gear pair.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Preview {
    /// Everything for which `POST /v1/assets` refuses these teeth, this speed and this pair, and what of the
    /// wear and the operating point cannot be; empty where all can be.
    refusals: Vec<Refusal>,
    /// Geometry of the pair, also of one that cannot be; none without a pair, and where its numbers give no
    /// geometry.
    #[serde(skip_serializing_if = "Option::is_none")]
    geometry: Option<GeometryView>,
    /// Greatest wear depth in µm that is previewed.
    #[serde(skip_serializing_if = "Option::is_none")]
    max_wear_um: Option<f64>,
    /// Mesh and vibration, unworn and worn; none where something is refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    model: Option<ModelView>,
}

/// Preview a gear pair
///
/// What the model says of a pair as it is described, without an asset or a library: geometry with its limits,
/// and at a wear depth, a torque and a speed the flanks, mesh stiffness, transmission error and the expected
/// vibration. A pair that cannot be is answered with everything that is wrong and with its geometry as far as
/// there is one. The mesh is worked out at the coarse resolution (the first ten mesh harmonics are within 1 %
/// of a library's), with the compliance of the unworn teeth, and the vibration over at most 256 mesh periods;
/// wear after Archard in steps of 1/24 of the greatest depth.
#[utoipa::path(
    post,
    path = "/v1/preview",
    tag = "libraries",
    request_body(content = Request, description = "The mesh, how far it is worn, and how it runs"),
    responses((status = 200, body = Preview)),
)]
pub(super) async fn preview(
    State(app): State<App>,
    headers: HeaderMap,
    body: Body,
) -> Result<Json<Preview>, Problem> {
    let _ticket = app.service.workers.admit_answer()?;
    let request: Request = body::described(&app.limits, &headers, body).await?;
    let models = app.previews.clone();
    let answer = app.service.workers.run("preview a gear pair", move || {
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
        let max_wear_um = max_wear_um(pair);
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
    Ok(Json(answer.await?))
}

/// Greatest wear depth in µm that is previewed: that of a library's grid.
fn max_wear_um(pair: &PairSpec) -> f64 {
    pair.usual_wear_um()
}

/// What an asset with this mesh is refused for, its pair's own numbers apart.
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
