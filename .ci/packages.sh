# Sourced by the set-up scripts, which say their `name`: messages, and Debian packages that are missing.

say() { printf '%s: %s\n' "$name" "$*" >&2; }
die() { say "error: $*"; exit 1; }

has_venv() { python3 -c 'import ensurepip, venv' 2>/dev/null; }

# Only what is missing is installed, so that a machine which has everything needs neither root nor a network.
install_debian() {
    local package missing=() root=()
    for package in "$@"; do
        [ "$(dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null)" = installed ] || missing+=("$package")
    done
    [ ${#missing[@]} -gt 0 ] || return 0
    if [ "$(id -u)" != 0 ]; then
        command -v sudo >/dev/null || die "these Debian packages are missing and there is no sudo: ${missing[*]}"
        root=(sudo)
    fi
    say "installing Debian packages: ${missing[*]}"
    # apt-get does not wait for another.
    local lock="${XDG_CACHE_HOME:-$HOME/.cache}/trocar/debian-lock"
    mkdir -p "$(dirname "$lock")"
    exec 8>"$lock"
    flock 8
    # A cut-off earlier installation leaves dpkg half configured; this finishes it.
    "${root[@]}" dpkg --configure -a >/dev/null 2>&1 || true
    "${root[@]}" apt-get update -qq || say 'the package lists could not be refreshed; trying with the old ones'
    "${root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null ||
        die "apt-get could not install: ${missing[*]} (is the package mirror reachable?)"
    exec 8>&-
}

install_npm() { command -v npm >/dev/null || install_debian npm; }
