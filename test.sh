#!/bin/sh
# Runs every test of the workspace. Needs a Rust toolchain and the package registry, nothing else.
set -eu
cd "$(dirname "$0")"
if ! command -v cargo >/dev/null 2>&1; then
    echo "test.sh: no cargo found. Install Rust from https://rustup.rs (version in Cargo.toml: rust-version)." >&2
    exit 1
fi
cargo test --workspace --locked "$@"
echo "test.sh: all tests ran"
