#!/bin/sh
# Runs every test of the workspace. Needs a Rust toolchain and the package registry; the tests of GigE cameras need the
# libraries of Aravis besides, which are installed where this is Debian and the rights are there. Where they cannot be had,
# all other tests run and the last line says so; with CI set that is a failure.
set -eu
cd "$(dirname "$0")"
if ! command -v cargo >/dev/null 2>&1; then
    echo "test.sh: no cargo found. Install Rust from https://rustup.rs (version in Cargo.toml: rust-version)." >&2
    exit 1
fi

has_aravis() {
    command -v pkg-config >/dev/null 2>&1 && pkg-config --exists 'aravis-0.8 >= 0.8.25' libusb-1.0
}

install_aravis() {
    command -v apt-get >/dev/null 2>&1 || return 1
    root=""
    if [ "$(id -u)" != 0 ]; then
        # Never a question in the middle of the tests.
        sudo -n true 2>/dev/null || return 1
        root="sudo -n"
    fi
    echo "test.sh: installing libaravis-dev libusb-1.0-0-dev aravis-tools pkg-config" >&2
    $root apt-get update -q >/dev/null &&
        DEBIAN_FRONTEND=noninteractive $root apt-get install -y -q --no-install-recommends \
            libaravis-dev libusb-1.0-0-dev aravis-tools pkg-config >/dev/null
}

has_aravis || install_aravis || true
if has_aravis; then
    cargo test --workspace --locked --features aravis "$@"
    echo "test.sh: all tests ran"
else
    cargo test --workspace --locked "$@"
    echo "test.sh: all tests but those of GigE cameras ran: libaravis-dev (0.8.25 or later) and libusb-1.0-0-dev could not be installed"
    [ -z "${CI:-}" ] || exit 1
fi
