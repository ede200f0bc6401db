//! What the types do not say: bounds, patterns and rules between fields, written into the API description
//! from a file.

use serde_json::{Map, Value};

/// The rules: `named` ones that others refer to by name, and those of `parameters` by operation (`*` for
/// all), of JSON `bodies` by operation and media type, and of the fields of `schemas` and of whole schemas
/// (`rules`).
const BOUNDS: &str = include_str!("bounds.json");

/// Writes the rules into the description; returns the names for which nothing was found.
pub(super) fn write_into(document: &mut Value) -> Vec<String> {
    // A file of this program, read by a test
    let bounds: Value = serde_json::from_str(BOUNDS).unwrap_or_default();
    let named = &bounds["named"];
    let mut missing = Vec::new();
    for (schema, fields) in members(&bounds["schemas"]) {
        for (field, rule) in members(fields) {
            let place = format!("/components/schemas/{schema}/properties/{field}");
            merge_at(document, &place, resolved(rule, named), &mut missing);
        }
    }
    for (schema, rule) in members(&bounds["rules"]) {
        merge_at(document, &format!("/components/schemas/{schema}"), rule, &mut missing);
    }
    for (operation, bodies) in members(&bounds["bodies"]) {
        for (media_type, rule) in members(bodies) {
            let place = format!(
                "{}/requestBody/content/{}/schema",
                place_of(operation),
                media_type.replace('/', "~1")
            );
            merge_at(document, &place, rule, &mut missing);
        }
    }
    for (operation, rules) in members(&bounds["parameters"]) {
        let places = match operation.as_str() {
            "*" => all_operations(document),
            one => vec![place_of(one)],
        };
        for (name, rule) in members(rules) {
            let rule = resolved(rule, named);
            let found = places.iter().filter(|place| restrict(document, place, name, rule)).count();
            if found == 0 {
                missing.push(format!("{operation} {name}"));
            }
        }
    }
    missing
}

fn members(value: &Value) -> impl Iterator<Item = (&String, &Value)> {
    value.as_object().into_iter().flatten()
}

/// A rule, or the named one it refers to.
fn resolved<'a>(rule: &'a Value, named: &'a Value) -> &'a Value {
    rule.as_str().map_or(rule, |name| &named[name])
}

/// The JSON pointer of an operation such as `GET /v1/alarms`.
fn place_of(operation: &str) -> String {
    let (method, path) = operation.split_once(' ').unwrap_or_default();
    format!("/paths/{}/{}", path.replace('/', "~1"), method.to_lowercase())
}

fn all_operations(document: &Value) -> Vec<String> {
    let paths = members(&document["paths"]);
    paths
        .flat_map(|(path, methods)| {
            members(methods).map(move |(method, _)| place_of(&format!("{method} {path}")))
        })
        .collect()
}

fn merge_at(document: &mut Value, place: &str, rule: &Value, missing: &mut Vec<String>) {
    match document.pointer_mut(place) {
        Some(value) if rule.is_object() => merge(value, rule),
        _ => missing.push(place.to_owned()),
    }
}

/// Restricts a query or header parameter of an operation; returns whether it has one with this name.
fn restrict(document: &mut Value, operation: &str, name: &str, rule: &Value) -> bool {
    let parameters = document.pointer_mut(&format!("{operation}/parameters")).and_then(Value::as_array_mut);
    let mut parameters = parameters.into_iter().flatten();
    let Some(parameter) = parameters.find(|one| one["name"] == name && one["in"] != "path") else {
        return false;
    };
    let mut rule = rule.clone();
    if let Some(required) = rule.as_object_mut().and_then(|rule| rule.remove("required")) {
        parameter["required"] = required;
    }
    merge(&mut parameter["schema"], &rule);
    rule.is_object()
}

/// Merges as RFC 7396 does: `null` removes a member.
fn merge(into: &mut Value, patch: &Value) {
    let Value::Object(patch) = patch else {
        *into = patch.clone();
        return;
    };
    if !into.is_object() {
        *into = Value::Object(Map::new());
    }
    for (name, value) in patch {
        if value.is_null() {
            into.as_object_mut().and_then(|members| members.remove(name));
        } else {
            merge(&mut into[name.as_str()], value);
        }
    }
}
