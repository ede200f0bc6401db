//! The dashboard's modules, type-checked by the TypeScript compiler against the API description, and
//! Plotly.js, compared with the published package.

use std::fs;
use std::path::Path;
use std::process::Command;

use flankwatch::http::plotly_js;

use crate::running::Service;
use flankwatch_test_support::needed;

#[test]
#[ignore = "needs Node and npm install in tests/browser"]
fn the_dashboards_modules_type_check_against_the_api() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/browser");
    let tools = folder.join("node_modules/.bin");
    needed(tools.join("tsc").exists().then_some(()), "`npm install` in tests/browser");
    // Path of the types in tsconfig.json.
    let types = folder.join("node_modules/.api");
    fs::create_dir_all(&types).unwrap();
    let service = Service::start();
    fs::write(types.join("openapi.json"), service.get("/openapi.json").expect(200).bytes).unwrap();
    run(
        &folder,
        "openapi-typescript",
        &["node_modules/.api/openapi.json", "-o", "node_modules/.api/api.d.ts"],
    );
    run(&folder, "tsc", &["-p", "."]);
}

#[test]
#[ignore = "needs npm install in tests/browser"]
fn plotly_is_the_published_bundle() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/browser/node_modules");
    let package = folder.join("plotly.js-cartesian-dist-min");
    needed(package.exists().then_some(()), "`npm install` in tests/browser");
    let published = fs::read_to_string(package.join("plotly-cartesian.min.js")).unwrap();
    assert!(plotly_js() == published, "src/http/plotly differs from the package");
}

#[track_caller]
fn run(folder: &Path, tool: &str, arguments: &[&str]) {
    let program = folder.join("node_modules/.bin").join(tool);
    let output = Command::new(program).args(arguments).current_dir(folder).output().unwrap();
    let text = [output.stdout, output.stderr].concat();
    assert!(output.status.success(), "{tool}: {}", String::from_utf8_lossy(&text));
}
