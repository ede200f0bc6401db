# Checks format, lints and documentation.
check:
    cargo fmt --all --check
    cargo clippy --locked --workspace --all-targets -- -D warnings
    RUSTDOCFLAGS="-D warnings" cargo doc --locked --workspace --no-deps

# Runs the tests that need only the toolchain.
test:
    cargo test --locked

# Runs all checks, with every server and tool.
ci:
    .ci/run

# Builds the static program, its Debian package, bill of materials and checksums in target/dist.
dist *targets:
    deploy/package/dist {{targets}}

# Generates the code from proto/.
generate:
    FLANKWATCH_GENERATE=1 cargo test --locked --package flankwatch-recording --test generated

# Takes the README's pictures, from a finished `flankwatch demo` at 127.0.0.1:8600.
pictures:
    FLANKWATCH_URL=http://127.0.0.1:8600 FLANKWATCH_ASSET=demo-gearbox FLANKWATCH_SHOTS=docs/images node tests/browser/pictures.mjs
