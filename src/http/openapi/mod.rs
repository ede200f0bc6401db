//! The API description (OpenAPI 3.1), generated from the handlers, and the page that shows it.

mod request_examples;

use std::sync::{Arc, OnceLock};

use axum::Router;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{Html, IntoResponse, Response};
use axum::routing::get;
use bytes::Bytes;
use serde_json::{Value, json};
use utoipa::PartialSchema;
use utoipa::openapi::OpenApi;

use super::problem::Details;

mod bounds;

/// Path of the Swagger UI files.
const UI_FILES: &str = "/docs/ui";

/// The page at `/docs`; its script is a separate file because inline scripts are blocked.
const PAGE: &str = include_str!("docs.html");

const SCRIPT: &str = include_str!("docs.js");

/// The description of the API as a whole.
const DESCRIPTION: &str = "Takes vibration records; returns condition indicators and wear depth with its interval. Times are RFC 3339 in UTC; a record's \
    time is that of its first sample. Wear depths are in micrometres, frequencies in hertz, and spectrum amplitudes are peak amplitudes. \
    Lists that can be long are paged by `cursor`. Errors are RFC 9457 problems that name the field, its value and what was expected. \
    Only 429, 502, 503, 504 and 507 are worth retrying, after the time in `Retry-After`.";

/// What the parameters in paths are.
const IN_PATH: [(&str, &str); 9] = [
    ("alarm", "The alarm"),
    ("asset", "The asset"),
    ("event", "The event"),
    ("library", "The library"),
    ("replay", "The replay"),
    ("segment", "The segment"),
    ("state", "Number of the state, from 0"),
    ("token", "The token's identifier, not the token itself"),
    ("upload", "The upload"),
];

/// Problems that any operation can return, and those of operations with a name in the path or with a body.
const COMMON: &[(&str, &str)] = &[
    ("400", "Invalid parameter"),
    ("401", "Token required"),
    ("403", "Insufficient scope, or a request from a page of another host"),
    ("429", "Too many requests with this token"),
    ("500", "Internal error"),
    ("503", "Temporarily unavailable: the queue is full or the request timed out"),
];
const WITH_NAME: &[(&str, &str)] = &[("404", "Not found")];
const WITH_BODY: &[(&str, &str)] = &[
    ("408", "Timeout while reading the body"),
    ("413", "The body is too large"),
    ("415", "Unsupported media type or content encoding"),
    ("422", "Invalid body"),
    ("507", "Insufficient storage"),
];

/// For operations that read a record's raw bytes.
const FROM_RAW: &[(&str, &str)] = &[("410", "The raw recording was deleted for the quota")];
const READ_RAW: [&str; 8] =
    ["/raw", "/waveform", "/spectrum", "/envelope", "/lines", "/orders", "/turn", "/cepstrum"];

/// For operations without a body that write a file.
const WITH_FILE: &[(&str, &str)] = &[("507", "Insufficient storage")];

/// The complete description as JSON.
fn document(generated: &OpenApi) -> Value {
    // A structure of strings, numbers and maps always serialises
    let mut document = serde_json::to_value(generated).unwrap_or_default();
    document["info"] = json!({
        "title": "flankwatch",
        "version": env!("CARGO_PKG_VERSION"),
        "description": DESCRIPTION,
        "license": { "name": "Apache-2.0", "identifier": "Apache-2.0" },
    });
    document["servers"] = json!([{ "url": "/" }]);
    document["components"]["schemas"]["Problem"] = json!(Details::schema());
    document["components"]["securitySchemes"] = json!({ "token": {
        "type": "http", "scheme": "bearer",
        "description": "A token created with `flankwatch token create`; not needed while no tokens exist.",
    }});
    document["security"] = json!([{}, { "token": [] }]);
    bounds::write_into(&mut document);
    let schemas = document["components"]["schemas"].clone();
    open_what_is_flattened(&mut document, &schemas);
    for (path, method, media_type, example) in request_examples::all() {
        let body = &mut document["paths"][path][method]["requestBody"]["content"];
        if let Some(content) = body.get_mut(media_type) {
            content["example"] = example;
        }
    }
    if let Some(paths) = document["paths"].as_object_mut() {
        for (path, operations) in paths {
            for (method, operation) in operations.as_object_mut().into_iter().flatten() {
                operation["operationId"] = json!(operation_id(method, path));
                add_path_parameters(path, operation);
                add_problems(path, operation);
            }
        }
    }
    document
}

/// A unique operation id; handler names are unique only within their files.
fn operation_id(method: &str, path: &str) -> String {
    let words = path.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    words.fold(method.to_owned(), |id, word| format!("{id}_{word}"))
}

/// Describes the parameters in the path of an operation, before its others.
fn add_path_parameters(path: &str, operation: &mut Value) {
    let mut parameters = Vec::new();
    for name in path.split('/').filter_map(|part| part.strip_prefix('{')?.strip_suffix('}')) {
        let description =
            IN_PATH.iter().find(|(known, _)| *known == name).map(|(_, description)| description);
        let schema = match name {
            "asset" => json!({ "$ref": "#/components/schemas/AssetId" }),
            _ => json!({ "type": "string" }),
        };
        parameters.push(json!({
            "name": name, "in": "path", "required": true, "description": description, "schema": schema,
        }));
    }
    let own = operation.get_mut("parameters").and_then(Value::as_array_mut).map(std::mem::take);
    let own = own.unwrap_or_default();
    parameters.extend(own.into_iter().filter(|parameter| parameter["in"] != "path"));
    if !parameters.is_empty() {
        operation["parameters"] = Value::Array(parameters);
    }
}

/// Adds the problems that every such operation can return, and the content of all problems. A response
/// without a description gets the standard text of its status.
fn add_problems(path: &str, operation: &mut Value) {
    let mut problems = COMMON.to_vec();
    if path.contains('{') {
        problems.extend(WITH_NAME);
    }
    if operation.get("requestBody").is_some() {
        problems.extend(WITH_BODY);
    }
    if READ_RAW.iter().any(|end| path.ends_with(end)) {
        problems.extend(FROM_RAW);
    }
    if path.ends_with("/export") {
        problems.extend(WITH_FILE);
    }
    let Some(responses) = operation["responses"].as_object_mut() else { return };
    for (status, description) in problems {
        responses.entry(status).or_insert_with(|| json!({ "description": description }));
    }
    for (status, response) in responses {
        if response["description"].as_str().is_none_or(str::is_empty) {
            let status = status.parse().ok().and_then(|code| StatusCode::from_u16(code).ok());
            response["description"] = json!(status.and_then(|status| status.canonical_reason()));
        }
        if status.starts_with(['4', '5']) && response.get("content").is_none() {
            let schema = json!({ "$ref": "#/components/schemas/Problem" });
            response["content"] = json!({ "application/problem+json": { "schema": schema } });
        }
    }
}

/// A schema that others flatten cannot refuse their members: it is written out there without that rule.
fn open_what_is_flattened(part: &mut Value, schemas: &Value) {
    match part {
        Value::Array(parts) => parts.iter_mut().for_each(|part| open_what_is_flattened(part, schemas)),
        Value::Object(members) => {
            for (name, member) in members {
                if name == "allOf" {
                    member.as_array_mut().into_iter().flatten().for_each(|part| write_out(part, schemas));
                }
                open_what_is_flattened(member, schemas);
            }
        }
        _ => {}
    }
}

fn write_out(part: &mut Value, schemas: &Value) {
    let name = part.get("$ref").and_then(Value::as_str).and_then(|text| text.rsplit('/').next());
    let Some(named) = name.and_then(|name| schemas.get(name)) else {
        return;
    };
    if named.get("additionalProperties") == Some(&Value::Bool(false)) {
        let mut whole = named.clone();
        if let Some(members) = whole.as_object_mut() {
            members.remove("additionalProperties");
        }
        *part = whole;
    }
}

/// `/openapi.json`, `/docs` and the files of the page.
pub(super) fn routes<S: Clone + Send + Sync + 'static>(generated: OpenApi) -> Router<S> {
    // Made when it is first asked for: a start does not wait for it.
    static TEXT: OnceLock<Bytes> = OnceLock::new();
    let generated = Arc::new(generated);
    let text = move || TEXT.get_or_init(|| document(&generated).to_string().into()).clone();
    let ui = swagger_ui_dist::generate_routes::<&str>(swagger_ui_dist::ApiDefinition {
        uri_prefix: UI_FILES,
        api_definition: swagger_ui_dist::OpenApiSource::Uri("/openapi.json"),
        title: None,
    });
    Router::new()
        .route("/openapi.json", get(move || async move { typed("application/json", text()) }))
        .route("/docs", get(|| async { Html(PAGE) }))
        .route(
            "/docs/docs.js",
            get(|| async { typed("text/javascript; charset=utf-8", Bytes::from_static(SCRIPT.as_bytes())) }),
        )
        .merge(ui.with_state(()))
}

fn typed(media_type: &'static str, bytes: Bytes) -> Response {
    ([(header::CONTENT_TYPE, HeaderValue::from_static(media_type))], bytes).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bound_is_of_something_in_the_description() {
        let generated = crate::http::router::operations().to_openapi();
        let mut document = serde_json::to_value(&generated).unwrap();
        assert_eq!(bounds::write_into(&mut document), Vec::<String>::new());
        let spec = |schema: &str| document["components"]["schemas"][schema].clone();
        assert_eq!(spec("GearSpec")["properties"]["teeth"]["items"]["minimum"], 4);
        assert_eq!(spec("AssetSpec")["oneOf"][0]["required"][0], "gear");
        let alarms = &document["paths"]["/v1/alarms"]["get"]["parameters"];
        assert!(alarms[0]["schema"]["pattern"].is_string(), "{alarms}");
    }

    #[test]
    fn every_response_has_a_description() {
        let document = document(&crate::http::router::operations().to_openapi());
        let paths = document["paths"].as_object().unwrap();
        let operations = paths.values().flat_map(|operations| operations.as_object().unwrap().values());
        let responses: Vec<&Value> =
            operations.flat_map(|operation| operation["responses"].as_object().unwrap().values()).collect();
        let is_described =
            |response: &&Value| response["description"].as_str().is_some_and(|text| !text.is_empty());
        assert!(responses.len() > 300 && responses.iter().all(is_described));
        assert_eq!(document["paths"]["/v1/assets"]["post"]["responses"]["201"]["description"], "Created");
    }

    #[test]
    fn every_parameter_in_a_path_is_described() {
        let document = document(&crate::http::router::operations().to_openapi());
        let paths = document["paths"].as_object().unwrap();
        let operations = paths.values().flat_map(|operations| operations.as_object().unwrap().values());
        let parameters = operations.flat_map(|operation| operation["parameters"].as_array()).flatten();
        let in_path: Vec<&Value> = parameters.filter(|parameter| parameter["in"] == "path").collect();
        assert!(in_path.len() > 50 && in_path.iter().all(|parameter| parameter["description"].is_string()));
    }
}
