#!/usr/bin/env bash
# Installs what only the tests of reports and of the console need and is missing: chromium. Safe to run twice and to cut off anywhere.
set -euo pipefail

name=setup-browser
. "$(dirname "${BASH_SOURCE[0]}")/packages.sh"

if command -v chromium >/dev/null && command -v ip >/dev/null; then
    say 'everything is here'
    exit
fi
command -v dpkg-query >/dev/null || die 'no Debian package manager: install chromium and iproute2'
install_debian chromium fonts-dejavu-core iproute2
say 'everything is here'
