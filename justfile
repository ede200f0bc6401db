# Format, lints, documentation.
check:
    cargo fmt --all --check
    cargo clippy --locked --workspace --all-targets -- -D warnings
    RUSTDOCFLAGS="-D warnings" cargo doc --locked --workspace --no-deps

# What needs nothing but the toolchain.
test:
    cargo test --locked

# Everything, with every server and tool.
ci:
    .ci/run

# The static program, its Debian package, bill of materials and checksums, in target/dist.
dist *targets:
    deploy/package/dist {{targets}}

# The code that is made from proto/.
generate:
    FLANKWATCH_GENERATE=1 cargo test --locked --package flankwatch-recording --test generated

# The README's pictures, of a `flankwatch demo` at 127.0.0.1:8600 that has told its story.
pictures:
    FLANKWATCH_URL=http://127.0.0.1:8600 FLANKWATCH_ASSET=demo-gearbox FLANKWATCH_SHOTS=docs/images node tests/browser/pictures.mjs
