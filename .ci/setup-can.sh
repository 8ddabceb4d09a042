#!/usr/bin/env bash
# Installs what only the CAN tests need and is missing: user-mode Linux, can-utils, tshark, and python canopen in a per-user cache.
# Safe to run twice and to cut off anywhere: nothing counts until it is complete and renamed into place.
set -euo pipefail
cd "$(dirname "$0")/.."

canopen=canopen==2.4.1
python_can=python-can==4.6.1
cache="${XDG_CACHE_HOME:-$HOME/.cache}/trocar"
venv="$cache/can-peers"
shim="$cache/uml-preload.so"

name=setup-can
. .ci/packages.sh

install_packages() {
    command -v dpkg-query >/dev/null || { say 'no Debian package manager: assuming that can-utils, tshark, iproute2, util-linux and a C compiler are here'; return; }
    local wanted=(can-utils tshark iproute2 util-linux python3 gcc libc6-dev)
    # Where the kernel itself has vcan no second kernel is needed.
    .ci/with-vcan --probe >/dev/null 2>&1 || wanted+=(user-mode-linux kmod)
    has_venv || wanted+=(python3-venv)
    install_debian "${wanted[@]}"
}

# A virtual environment knows its own path, so it is built in place; the file `complete`, which names the versions, makes it count.
install_peers() {
    local versions="$canopen $python_can $(python3 -c 'import sys; print(sys.base_prefix, sys.version.split()[0])')"
    [ "$(cat "$venv/complete" 2>/dev/null)" != "$versions" ] || return 0
    has_venv || die 'python3 here has no venv module: install it, and run this again'
    say "installing $canopen and $python_can from PyPI into the cache"
    rm -rf "$venv"
    python3 -m venv "$venv" >&2
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check "$canopen" "$python_can" >&2 ||
        die 'PyPI could not be reached or has no such versions'
    printf '%s\n' "$versions" >"$venv/complete.part"
    mv "$venv/complete.part" "$venv/complete"
}

build_shim() {
    [ "$(uname -m)" = x86_64 ] || return 0
    [ .ci/uml-preload.c -nt "$shim" ] || return 0
    cc -O2 -Wall -Wextra -Werror -shared -fPIC -o "$shim.part" .ci/uml-preload.c
    mv "$shim.part" "$shim"
}

mkdir -p "$cache"
exec 9>"$cache/can-lock"
flock -n 9 || { say 'waiting for another set-up to finish'; flock 9; }
install_packages
install_peers
build_shim
say 'everything is here'
