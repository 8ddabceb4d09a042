#!/usr/bin/env bash
# Packs once more, which must give the same bytes, and unpacks what `make dist` made in a bare Debian root and runs the demo there as a user who may do nothing else: once from the archive, once
# installed from the packages. Needs root and a Debian mirror.
set -euo pipefail
cd "$(dirname "$0")/../.."
dist=$(realpath "${1:-target/dist}")
mirror=${DEBIAN_MIRROR:-$(sed -n 's/^URIs: *//p' /etc/apt/sources.list.d/debian.sources 2>/dev/null | head -n 1 || true)}
mirror=${mirror:-http://deb.debian.org/debian}

say() { printf 'dist_in_bare_debian: %s\n' "$*" >&2; }
[ "$(id -u)" = 0 ] || { say 'error: needs root'; exit 1; }
command -v debootstrap >/dev/null || apt-get install -y -qq --no-install-recommends debootstrap >/dev/null

say 'packing once more: the same bytes'
again=$(mktemp -d)
.ci/dist "$again" >/dev/null
cmp "$dist/SHA256SUMS" "$again/SHA256SUMS"
rm -rf "$again"

root=$(mktemp -d "${TMPDIR:-/tmp}/bare-debian.XXXXXX")
chmod 755 "$root"
leave() {
    umount "$root/proc" "$root/dev/shm" "$root/dev/pts" 2>/dev/null || true
    rm -rf --one-file-system "$root"
}
trap leave EXIT
say "making a bare Debian of $mirror"
debootstrap --variant=minbase bookworm "$root" "$mirror" >"$root.log" 2>&1 || { tail -n 20 "$root.log" >&2; exit 1; }
rm -f "$root.log"
for file in /etc/apt/apt.conf.d/*proxy* /etc/apt/auth.conf.d/*; do [ ! -e "$file" ] || cp --parents "$file" "$root"; done
mount -t proc proc "$root/proc"
mkdir -p "$root/dev/shm" && mount -t tmpfs shm "$root/dev/shm"
mkdir -p "$root/dev/pts" && mount -t devpts pts "$root/dev/pts"
inside() { chroot "$root" "$@"; }
as_user() { inside runuser -u somebody -- env -i HOME=/home/somebody PATH=/usr/bin:/bin "$@"; }
inside useradd --create-home somebody
cp "$dist"/*.zst "$dist"/*.deb "$root/home/somebody/"

say 'the archive, unpacked by the user; what a driver of Vulkan needs is installed'
inside apt-get update -qq
inside env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends zstd libvulkan1 mesa-vulkan-drivers libstdc++6 >/dev/null
as_user sh -c 'cd && tar --zstd -xf trocar-[0-9]*-x86_64.tar.zst && ./trocar-*/bin/trocar --version'
as_user sh -c 'cd && ./trocar-*/bin/trocar demo --out archive'
as_user sh -c 'cd && rm -r trocar-*/'

say 'the packages'
inside sh -c 'DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends /home/somebody/*.deb >/dev/null'
as_user sh -c 'cd && trocar demo --out package && trocar demo --task suture-pad --out pad && trocar eval --task needle-lift --policy needle-lift/act-compact --trials 1 --json - >eval.json'
as_user sh -c 'cd && trocar verify package/run.mcap && grep -q "\"successes\": 1" eval.json'
inside grep -q PyTorch /usr/share/doc/trocar/copyright
inside test -s /usr/share/doc/trocar-policies/copyright
inside test -e /usr/share/man/man1/trocar-run.1 -a -e /lib/systemd/system/trocar@.service
inside apt-get purge -y -qq trocar trocar-policies >/dev/null
! inside test -e /usr/lib/trocar -o -e /usr/bin/trocar
say 'all well'
