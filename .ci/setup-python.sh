#!/usr/bin/env bash
# Makes the virtual environment that the tests of the Python package run in, in target/python. Safe to run twice and to cut off anywhere:
# nothing counts until it is complete and named.
set -euo pipefail
cd "$(dirname "$0")/.."

venv=target/python
package=policy/python

name=setup-python
. .ci/packages.sh

install_packages() {
    has_venv && return
    command -v dpkg-query >/dev/null || die 'python3 here has no venv module: install it, and run this again'
    install_debian python3-venv
}

# A virtual environment knows its own path, so it is built in place; the file `complete`, which says what it was made of, makes it count.
install_package() {
    local made_of
    made_of="$(sha256sum <"$package/pyproject.toml") $(python3 -c 'import sys; print(sys.base_prefix, sys.version.split()[0])') $PWD"
    [ "$(cat "$venv/complete" 2>/dev/null)" != "$made_of" ] || return 0
    say 'installing the package and what its tests need from PyPI'
    rm -rf "$venv"
    mkdir -p target
    python3 -m venv "$venv" >&2
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --editable "$package[test]" >&2 ||
        die 'PyPI could not be reached or lacks a package'
    printf '%s\n' "$made_of" >"$venv/complete.part"
    mv "$venv/complete.part" "$venv/complete"
}

mkdir -p target
exec 9>target/python-lock
flock -n 9 || { say 'waiting for another set-up to finish'; flock 9; }
install_packages
install_package
say 'everything is here'
