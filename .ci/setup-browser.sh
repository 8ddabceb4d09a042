#!/usr/bin/env bash
# Installs what only the tests of reports and of the console need and is missing: chromium. Safe to run twice and to cut off anywhere.
set -euo pipefail

say() { printf 'setup-browser: %s\n' "$*" >&2; }
die() { say "error: $*"; exit 1; }

if command -v chromium >/dev/null; then
    say 'everything is here'
    exit
fi
command -v dpkg-query >/dev/null || die 'no chromium and no Debian package manager: install chromium'
root=()
if [ "$(id -u)" != 0 ]; then
    command -v sudo >/dev/null || die 'the Debian package chromium is missing and there is no sudo'
    root=(sudo)
fi
say 'installing Debian packages: chromium'
# A cut-off earlier installation leaves dpkg half configured; this finishes it.
"${root[@]}" dpkg --configure -a >/dev/null 2>&1 || true
"${root[@]}" apt-get update -qq || say 'the package lists could not be refreshed; trying with the old ones'
"${root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium fonts-dejavu-core >/dev/null ||
    die 'apt-get could not install chromium (is the package mirror reachable?)'
say 'everything is here'
