#!/usr/bin/env bash
# Installs what only the tests of reports and of the console need and is missing: chromium, and IWER, the emulated headset, out of npm's
# registry into a per-user cache. Safe to run twice and to cut off anywhere: nothing counts until it is complete and renamed into place.
set -euo pipefail

iwer_version=2.5.0
iwer_sha256=e7eb4efa736c0b52c6917a6ed093f3a287fd7eb59a6d371f6ce857d602f59263
cache="${XDG_CACHE_HOME:-$HOME/.cache}/trocar"
iwer="$cache/iwer-$iwer_version"

name=setup-browser
. "$(dirname "${BASH_SOURCE[0]}")/packages.sh"

install_iwer() {
    [ ! -e "$iwer/iwer.min.js" ] || return 0
    install_npm
    mkdir -p "$cache"
    exec 9>"$cache/lock"
    flock -n 9 || { say 'waiting for another set-up to finish'; flock 9; }
    [ ! -e "$iwer/iwer.min.js" ] || return 0
    local part="$iwer.part"
    rm -rf "$part" "$iwer"
    mkdir -p "$part"
    say "downloading IWER $iwer_version from npm's registry into the cache"
    (cd "$part" && npm pack --silent "iwer@$iwer_version" >/dev/null) || die "npm's registry could not be reached or lacks iwer $iwer_version"
    printf '%s  %s\n' "$iwer_sha256" "$part/iwer-$iwer_version.tgz" | sha256sum --check --quiet || die "iwer $iwer_version is not what it was"
    tar -xzf "$part/iwer-$iwer_version.tgz" -C "$part" --strip-components=2 package/build/iwer.min.js
    tar -xzf "$part/iwer-$iwer_version.tgz" -C "$part" --strip-components=1 package/LICENSE
    rm "$part/iwer-$iwer_version.tgz"
    mv "$part" "$iwer"
}

if ! command -v chromium >/dev/null || ! command -v ip >/dev/null; then
    command -v dpkg-query >/dev/null || die 'no Debian package manager: install chromium and iproute2'
    install_debian chromium fonts-dejavu-core iproute2
fi
install_iwer
say 'everything is here'
