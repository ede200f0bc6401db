//! The API description.

use flankwatch::store::Scope;
use serde_json::Value;

use crate::alarms::{at_once, loud, watched};
use crate::running::{Service, mcap, record};
use crate::tokens::Tokens;

fn description(service: &Service) -> Value {
    service.get("/openapi.json").expect(200).json()
}

#[test]
fn every_field_parameter_and_operation_is_documented() {
    let service = Service::start();
    let document = description(&service);
    assert_eq!(document["openapi"], "3.1.0");
    let mut silent = Vec::new();
    for (name, schema) in document["components"]["schemas"].as_object().unwrap() {
        let parts = schema["allOf"].as_array().into_iter().flatten().chain([schema]);
        for (field, property) in parts.filter_map(|part| part["properties"].as_object()).flatten() {
            // The description of an optional structure is next to its reference.
            let mut places = property["oneOf"].as_array().into_iter().flatten().chain([property]);
            if !places.any(|place| place["description"].as_str().is_some_and(|text| !text.is_empty())) {
                silent.push(format!("{name}.{field}"));
            }
        }
    }
    let mut operations = 0;
    let mut ids = std::collections::HashSet::new();
    for (path, methods) in document["paths"].as_object().unwrap() {
        for (method, operation) in methods.as_object().unwrap() {
            operations += 1;
            let id = operation["operationId"].as_str().unwrap();
            assert!(ids.insert(id), "{id} names two operations");
            if operation["summary"].as_str().is_none_or(str::is_empty) {
                silent.push(format!("{method} {path}"));
            }
            for parameter in operation["parameters"].as_array().into_iter().flatten() {
                if parameter["description"].as_str().is_none_or(str::is_empty) {
                    silent.push(format!("{method} {path} {}", parameter["name"]));
                }
            }
        }
    }
    assert!(silent.is_empty(), "without a description: {}", silent.join(", "));
    assert!(operations > 20, "{operations}");
}

#[test]
fn uploads_and_errors_are_described_as_they_are() {
    let service = Service::start();
    service.plain_asset("pump");
    let document = description(&service);
    let refused = service.post("/v1/assets/pump/segments", "text/plain", b"").expect_problem(415, &[]);
    let accepted =
        refused["detail"].as_str().unwrap().split_once("expected ").unwrap().1.replace(" or ", ", ");
    let described = &document["paths"]["/v1/assets/{asset}/segments"]["post"]["requestBody"]["content"];
    let mut described: Vec<&str> = described.as_object().unwrap().keys().map(String::as_str).collect();
    let mut accepted: Vec<&str> = accepted.split(", ").collect();
    described.sort_unstable();
    accepted.sort_unstable();
    assert_eq!(described, accepted);
    let text = document["info"]["description"].as_str().unwrap();
    assert!(text.contains("Only 429, 502, 503, 504 and 507"), "{text}");
    let operations = document["paths"].as_object().unwrap().values();
    let operations = operations.flat_map(|methods| methods.as_object().unwrap().values());
    let tags: std::collections::BTreeSet<&str> =
        operations.flat_map(|one| one["tags"].as_array().unwrap()).map(|tag| tag.as_str().unwrap()).collect();
    assert!(tags.contains("records") && !tags.contains("segments"), "{tags:?}");
}

#[test]
fn the_lists_that_take_a_cursor_are_those_of_the_documentation() {
    let service = Service::start();
    let paths = description(&service)["paths"].clone();
    let mut paged: Vec<&str> = Vec::new();
    for (path, methods) in paths.as_object().unwrap() {
        let parameters = methods["get"]["parameters"].as_array().into_iter().flatten();
        let names: Vec<&str> = parameters.filter_map(|parameter| parameter["name"].as_str()).collect();
        if names.contains(&"limit") && names.contains(&"cursor") {
            paged.push(path);
        }
    }
    paged.sort_unstable();
    // "Those of alarms, assets, libraries, maintenance events, records, replays and tokens"
    let expected = [
        "/v1/alarms",
        "/v1/assets",
        "/v1/assets/{asset}/maintenance",
        "/v1/assets/{asset}/segments",
        "/v1/libraries",
        "/v1/replays",
        "/v1/tokens",
    ];
    assert_eq!(paged, expected);
}

#[test]
fn the_openapi_page_loads_nothing_from_other_hosts() {
    let service = Service::start();
    let page = service.get("/docs").expect(200);
    let text = String::from_utf8(page.bytes).unwrap();
    assert!(!text.contains("http://") && !text.contains("https://"), "{text}");
    for file in text.split("src=\"").skip(1).map(|rest| rest.split('"').next().unwrap()) {
        assert!(
            service
                .get(&format!("/{file}"))
                .expect(200)
                .header("content-type")
                .starts_with("text/javascript")
        );
    }
    assert!(service.get("/docs/ui/swagger-ui.css").expect(200).bytes.len() > 10_000);
}

#[test]
fn every_example_of_a_request_runs() {
    let service = Service::start();
    service.post_json("/v1/assets", &watched("gearbox-1", &at_once())).expect(201);
    service.upload("gearbox-1", &loud(0, 4.0));
    let alarm = service.get("/v1/alarms").expect(200).json()["items"][0]["id"].as_str().unwrap().to_owned();
    std::fs::write(service.folder().join("recordings/run.mcap"), mcap(&[record("a1", 5)])).unwrap();
    let token = Tokens::of(service.folder()).create("examples", Scope::Admin);
    let authorization = format!("Bearer {token}");
    let document = description(&service);
    let mut sent = 0;
    for (path, methods) in document["paths"].as_object().unwrap() {
        for (method, operation) in methods.as_object().unwrap() {
            for (media_type, content) in operation["requestBody"]["content"].as_object().into_iter().flatten()
            {
                let example = &content["example"];
                if !["application/json", "application/toml"].contains(&media_type.as_str()) {
                    continue;
                }
                assert!(!example.is_null(), "{method} {path} has no example of {media_type}");
                let body = example.as_str().map_or_else(|| example.to_string(), str::to_owned);
                let address = path.replace("{asset}", "gearbox-1").replace("{alarm}", &alarm);
                let headers =
                    [("content-type", media_type.as_str()), ("authorization", authorization.as_str())];
                let answer = service.send(&method.to_uppercase(), &address, &headers, body.as_bytes());
                let mut documented = operation["responses"].as_object().unwrap().keys();
                let success = documented.find(|status| status.starts_with('2')).unwrap();
                assert_eq!(
                    answer.status.to_string(),
                    *success,
                    "{method} {path}: {}",
                    String::from_utf8_lossy(&answer.bytes)
                );
                sent += 1;
            }
        }
    }
    assert!(sent >= 10, "{sent}");
}

/// Returns the names in the first column of the table of docs/api.md with this heading.
fn documented(heading: &str) -> Vec<String> {
    let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/api.md")).unwrap();
    let table = text.split_once(&format!("| `{heading}` |")).unwrap_or_else(|| panic!("no table {heading}"));
    let rows = table.1.lines().skip(2).take_while(|line| line.starts_with("| `"));
    rows.map(|row| row[3..].split('`').next().unwrap().to_owned()).collect()
}

#[test]
fn every_name_of_an_estimate_is_in_the_documentation_and_the_dashboard() {
    let service = Service::start();
    let document = description(&service);
    let names = |schema: &str| -> Vec<String> {
        let schema = &document["components"]["schemas"][schema];
        // Those with a description each stand one by one.
        let each = schema["oneOf"].as_array().into_iter().flatten();
        let each = each.flat_map(|one| one["enum"].as_array().into_iter().flatten().chain(one.get("const")));
        let all = schema["enum"].as_array().into_iter().flatten().chain(each);
        all.map(|name| name.as_str().unwrap().to_owned()).collect()
    };
    for (schema, heading, page) in [
        ("WearStatus", "status", "state.js"),
        ("SensorFault", "novelty.sensor_fault", "match-words.js"),
        ("SuspectedFault", "novelty.suspected_fault", "match-words.js"),
    ] {
        let (names, documented) = (names(schema), documented(heading));
        assert!(!names.is_empty(), "{schema}: {}", document["components"]["schemas"][schema]);
        let [mut of_code, mut of_docs] = [names.clone(), documented];
        of_code.sort();
        of_docs.sort();
        assert_eq!(of_code, of_docs, "{schema} and the table {heading:?} of docs/api.md");
        let words =
            std::fs::read_to_string(format!("{}/src/http/dashboard/{page}", env!("CARGO_MANIFEST_DIR")))
                .unwrap();
        for name in names {
            assert!(words.contains(&name), "{page} has no words for {name}");
        }
    }
    let words = format!("{}/src/http/dashboard/alarm-words.js", env!("CARGO_MANIFEST_DIR"));
    let words = std::fs::read_to_string(words).unwrap();
    let (quantities, documented) = (names("AlarmQuantity"), documented("quantity"));
    assert!(quantities.len() >= 6, "{quantities:?}");
    for name in quantities {
        assert!(documented.contains(&format!("\"{name}\"")), "{name} is not in docs/api.md: {documented:?}");
        assert!(words.contains(&name), "alarm-words.js has no words for {name}");
    }
}
