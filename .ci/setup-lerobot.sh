#!/usr/bin/env bash
# Makes the virtual environment with LeRobot in target/lerobot: the package, the plug-in, and what `make test-lerobot` runs. Wants Python 3.12 or
# newer, as LeRobot 0.6 does. Safe to run twice and to cut off anywhere: nothing counts until it is complete and named.
set -euo pipefail
cd "$(dirname "$0")/.."

venv=target/lerobot
package=policy/python

name=setup-lerobot
. .ci/packages.sh

# The first Python that is new enough: on the path, or of pyenv, whose commands on the path may be those of another version.
find_python() {
    local one
    for one in python3 python3.13 python3.12 "${PYENV_ROOT:-$HOME/.pyenv}"/versions/3.1[23]*/bin/python3; do
        if "$one" -c 'import sys, venv, ensurepip; sys.exit(not (3, 12) <= sys.version_info < (3, 14))' 2>/dev/null; then
            printf '%s\n' "$one"
            return
        fi
    done
    die 'LeRobot 0.6 wants Python 3.12 or 3.13 with its venv module, and there is none: install one (uv, conda, pyenv), and run this again'
}

# A virtual environment knows its own path, so it is built in place; the file `complete`, which says what it was made of, makes it count.
install_package() {
    local python made_of
    python=$(find_python)
    made_of="$(cat "$package/pyproject.toml" "$package/lerobot_env_trocar/pyproject.toml" | sha256sum) $("$python" -c 'import sys; print(sys.base_prefix, sys.version.split()[0])') $PWD"
    [ "$(cat "$venv/complete" 2>/dev/null)" != "$made_of" ] || return 0
    say 'installing LeRobot with PyTorch from PyPI: 5.5 GB on disk'
    rm -rf "$venv"
    "$python" -m venv "$venv" >&2
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --editable "$package[gym,lerobot,pandas]" \
        --editable "$package/lerobot_env_trocar" 'pytest>=8' >&2 || die 'PyPI could not be reached or lacks a package'
    printf '%s\n' "$made_of" >"$venv/complete.part"
    mv "$venv/complete.part" "$venv/complete"
}

mkdir -p target
exec 9>target/lerobot-lock
flock -n 9 || { say 'waiting for another set-up to finish'; flock 9; }
install_package
say 'everything is here'
