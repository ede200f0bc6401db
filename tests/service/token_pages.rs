//! Tokens created and revoked over HTTP.

use flankwatch::store::Scope;
use serde_json::{Value, json};

use crate::running::{Answer, Service};
use crate::tokens::Tokens;

fn as_bearer(service: &Service, token: &str, method: &str, path: &str, body: &Value) -> Answer {
    let authorization = format!("Bearer {token}");
    let headers = [("authorization", authorization.as_str()), ("content-type", "application/json")];
    let text = if body.is_null() { String::new() } else { body.to_string() };
    service.send(method, path, &headers, text.as_bytes())
}

#[test]
fn the_first_token_enables_authentication_and_creates_and_revokes_others() {
    let service = Service::start();
    assert_eq!(service.get("/v1/tokens").expect(200).json()["items"], json!([]));
    let refused = service.post_json("/v1/tokens", &json!({ "name": "desk", "scope": "read" }));
    let problem = refused.expect_problem(422, &["scope", "read", "admin"]);
    assert_eq!(problem["field"], "scope");
    for name in ["", "  ", "a\nb", &"x".repeat(201)] {
        let answer = service.post_json("/v1/tokens", &json!({ "name": name, "scope": "admin" }));
        assert_eq!(answer.expect_problem(422, &["name"])["field"], "name");
    }
    let made = service.post_json("/v1/tokens", &json!({ "name": "desk", "scope": "admin" })).expect(201);
    assert_eq!(made.header("cache-control"), "no-store");
    let made = made.json();
    let admin = made["token"].as_str().unwrap().to_owned();
    service.get("/v1/tokens").expect_problem(401, &["token"]);
    service.post_json("/v1/tokens", &json!({ "name": "x", "scope": "admin" })).expect_problem(401, &[]);

    let request = json!({ "name": "press line", "scope": "write" });
    let other = as_bearer(&service, &admin, "POST", "/v1/tokens", &request).expect(201).json();
    let write = other["token"].as_str().unwrap().to_owned();
    as_bearer(&service, &write, "GET", "/v1/assets", &Value::Null).expect(200);
    for (method, path) in [
        ("GET", "/v1/tokens".to_owned()),
        ("POST", "/v1/tokens".to_owned()),
        ("DELETE", format!("/v1/tokens/{}", made["id"].as_str().unwrap())),
    ] {
        as_bearer(&service, &write, method, &path, &request).expect_problem(403, &["write", "admin"]);
    }

    let list = as_bearer(&service, &admin, "GET", "/v1/tokens", &Value::Null).expect(200).json();
    let names: Vec<&Value> = list["items"].as_array().unwrap().iter().map(|token| &token["name"]).collect();
    assert_eq!(names.len(), 2);
    assert!(names.contains(&&json!("desk")) && names.contains(&&json!("press line")), "{list}");
    for secret in [&admin, &write] {
        let secret = secret.rsplit('_').next().unwrap();
        assert!(!list.to_string().contains(secret) && !list.to_string().contains("sha256"), "{list}");
        let kept = std::fs::read(service.folder().join("tokens.db")).unwrap();
        let kept = String::from_utf8_lossy(&kept);
        assert!(!kept.contains(secret));
    }
    let first = as_bearer(&service, &admin, "GET", "/v1/tokens?limit=1", &Value::Null).expect(200).json();
    let next = format!("/v1/tokens?limit=1&cursor={}", first["next_cursor"].as_str().unwrap());
    let second = as_bearer(&service, &admin, "GET", &next, &Value::Null).expect(200).json();
    assert_ne!(first["items"][0]["id"], second["items"][0]["id"]);
    assert_eq!(second["next_cursor"], Value::Null);

    let path = |token: &Value| format!("/v1/tokens/{}", token["id"].as_str().unwrap());
    as_bearer(&service, &admin, "DELETE", &path(&other), &Value::Null).expect(204);
    as_bearer(&service, &write, "GET", "/v1/assets", &Value::Null).expect_problem(401, &["revoked"]);
    as_bearer(&service, &admin, "DELETE", &path(&other), &Value::Null).expect_problem(404, &[]);
    as_bearer(&service, &admin, "DELETE", &path(&made), &Value::Null).expect_problem(409, &["last", "admin"]);
    as_bearer(&service, &admin, "GET", "/v1/assets", &Value::Null).expect(200);
}

#[test]
fn no_token_is_created_over_http_with_authentication_disabled() {
    let service = Service::start_with(|config| config.insecure_no_tokens = true);
    let request = json!({ "name": "later", "scope": "admin" });
    service.get("/v1/tokens").expect_problem(403, &["insecure-no-tokens"]);
    service.post_json("/v1/tokens", &request).expect_problem(403, &["insecure-no-tokens"]);
    let tokens = Tokens::of(service.folder());
    assert!(tokens.list().is_none());
    tokens.create("a", Scope::Admin);
    let id = tokens.list().unwrap()[0].id.clone();
    service.delete(&format!("/v1/tokens/{id}")).expect_problem(403, &["insecure-no-tokens"]);
}
