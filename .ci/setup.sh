#!/usr/bin/env bash
# Installs what the build needs and is missing: Debian packages, and libtorch out of PyPI's torch wheel into a per-user cache.
# Safe to run twice and to cut off anywhere: nothing counts until it is complete and renamed into place.
set -euo pipefail
cd "$(dirname "$0")/.."

torch_version=2.11.0
cache="${XDG_CACHE_HOME:-$HOME/.cache}/trocar"
libtorch="$cache/libtorch-$torch_version"

name=setup
. .ci/packages.sh

install_packages() {
    command -v dpkg-query >/dev/null || { say 'no Debian package manager: assuming that a C++ compiler, python3 with pip, a Vulkan driver and ffmpeg are here'; return; }
    local wanted=(g++ make ca-certificates python3 libvulkan1 mesa-vulkan-drivers ffmpeg)
    [ -n "${LIBTORCH:-}" ] || [ -e "$libtorch/complete" ] || python3 -m pip --version >/dev/null 2>&1 || wanted+=(python3-pip)
    install_debian "${wanted[@]}"
}

check_rust() {
    command -v cargo >/dev/null || die 'cargo is missing, and Debian 12 ships one that is too old: install Rust 1.95 or newer with rustup'
    local have
    have=$(cargo --version | sed -E 's/^cargo ([0-9]+\.[0-9]+).*/\1/')
    [ "$(printf '%s\n1.95\n' "$have" | sort -V | head -1)" = 1.95 ] || die "Rust $have is too old: 1.95 or newer is needed (rustup update)"
}

# The wheels are zip files; only the libraries and headers of the CPU build are taken out of them, and licences, which `make dist` packs.
unpack_libtorch() {
    python3 - "$1" "$2" "$torch_version" <<'PYTHON'
import pathlib, shutil, sys, zipfile

wheels, out, version = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]), sys.argv[3]
unwanted = {"libtorch_python.so", "libshm.so", "libtorch_global_deps.so", "libtorch_nvshmem.so", "libcaffe2_nvrtc.so",
            "libc10_cuda.so", "libtorch.so"}
for wheel in sorted(wheels.glob("*.whl")):
    with zipfile.ZipFile(wheel) as archive:
        for member in archive.infolist():
            path = pathlib.PurePosixPath(member.filename)
            wanted = path.parts[:2] == ("torch", "include") or (
                path.parts[:2] == ("torch", "lib") and path.name not in unwanted
                and not path.name.startswith("libtorch_cuda")) or path.name in ("libcudart.so.13", "libcupti.so.13") or (
                path.parts[0].endswith(".dist-info") and path.name.lower().startswith(("license", "notice")))
            if wanted and not member.is_dir():
                target = out / path
                target.parent.mkdir(parents=True, exist_ok=True)
                with archive.open(member) as source, open(target, "wb") as sink:
                    shutil.copyfileobj(source, sink, 1 << 20)
(out / "torch/lib/libtorch.so").symlink_to("libtorch_cpu.so")
(out / "torch/build-version").write_text(version)
for needed in ("torch/lib/libtorch_cpu.so", "torch/lib/libc10.so", "torch/include/torch/csrc/api/include/torch/torch.h",
               "nvidia/cu13/lib/libcudart.so.13"):
    if not (out / needed).exists():
        sys.exit(f"the wheels hold no {needed}")
PYTHON
}

install_libtorch() {
    if [ -n "${LIBTORCH:-}" ]; then
        case "$LIBTORCH" in /*) ;; *) die "LIBTORCH=$LIBTORCH is no absolute path, and cargo builds in other folders" ;; esac
        local needed
        for needed in lib/libtorch_cpu.so include/torch/csrc/api/include/torch/torch.h; do
            [ -e "$LIBTORCH/$needed" ] || die "LIBTORCH=$LIBTORCH holds no $needed"
        done
        say "using your own LIBTORCH"
        return
    fi
    mkdir -p "$cache"
    exec 9>"$cache/lock"
    flock -n 9 || { say 'waiting for another set-up to finish'; flock 9; }
    if [ ! -e "$libtorch/complete" ]; then
        [ "$(uname -m)" = x86_64 ] || die "no libtorch wheel is known for $(uname -m): set LIBTORCH to a libtorch $torch_version"
        local part="$libtorch.part"
        rm -rf "$part/tree"
        mkdir -p "$part/wheels"
        # pip takes a platform tag literally, so every glibc that a wheel may name is listed.
        local platforms=(--platform manylinux2014_x86_64) glibc
        for glibc in $(seq 17 28); do platforms+=(--platform "manylinux_2_${glibc}_x86_64"); done
        say "downloading libtorch $torch_version (540 MB) from PyPI into the cache"
        python3 -m pip download --quiet --no-deps --only-binary=:all: --python-version 3.11 --implementation cp \
            "${platforms[@]}" --dest "$part/wheels" \
            "torch==$torch_version" 'nvidia-cuda-runtime==13.0.*' 'nvidia-cuda-cupti==13.0.*' >&2 9>&- ||
            die 'PyPI could not be reached or has no such wheel; set LIBTORCH to a libtorch of your own to do without it'
        say 'unpacking it (500 MB)'
        unpack_libtorch "$part/wheels" "$part/tree" >&2 || die 'the wheels could not be unpacked (is the disk full?)'
        touch "$part/tree/complete"
        rm -rf "$libtorch"
        mv "$part/tree" "$libtorch"
    fi
    # Also what an earlier run left that was cut off after its last rename.
    rm -rf "$libtorch.part"
    flock -u 9
    # .cargo/config.toml points here, so that a plain `cargo build` finds it too.
    ln -sfn "$libtorch/torch" .cargo/libtorch
}

check_rust
install_packages
install_libtorch
say 'everything is here'
