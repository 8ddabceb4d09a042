#!/usr/bin/env bash
# Makes the virtual environment with which others' programs judge the anatomy crate, in target/anatomy, and puts beside it the Khronos glTF
# validator, by npm, which is installed if missing, and label volumes that no one here made. Safe to run twice and to cut off anywhere:
# nothing counts until it is complete and named.
set -euo pipefail
cd "$(dirname "$0")/.."

venv=target/anatomy
packages=(nibabel==5.4.2 SimpleITK==2.5.7 trimesh==5.2.0 usd-core==26.11 numpy==2.4.6 scipy==1.17.1)
validator=gltf-validator@2.0.0-dev.3.10
# Its sources come with a CT as DICOM, and labels of it and of another (Apache 2.0).
others=TotalSegmentator==2.18.0

name=setup-anatomy
. .ci/packages.sh

install_programs() {
    local made_of
    made_of="${packages[*]} $validator $(python3 -c 'import sys; print(sys.base_prefix, sys.version.split()[0])') $PWD"
    [ "$(cat "$venv/complete" 2>/dev/null)" != "$made_of" ] || return 0
    install_npm
    has_venv || die 'python3 here has no venv module: install python3-venv, and run this again'
    say "installing ${packages[*]}"
    rm -rf "$venv"
    python3 -m venv "$venv" >&2
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check "${packages[@]}" >&2 || die 'PyPI could not be reached or lacks a package'
    npm install --silent --no-audit --no-fund --prefix "$venv" "$validator" >&2 || die 'npm could not install the glTF validator'
    printf '%s\n' "$made_of" >"$venv/complete.part"
    mv "$venv/complete.part" "$venv/complete"
}

# Of 38 MB the three examples stay. Without them the test says so and goes on.
get_others() {
    local into=$venv/others part=$venv/others.part examples='*/tests/reference_files/example_'
    [ ! -d "$into" ] || return 0
    say "downloading the examples of $others"
    rm -rf "$part"
    mkdir "$part"
    if "$venv/bin/python" -m pip download --quiet --disable-pip-version-check --no-deps --no-binary TotalSegmentator --dest "$part" "$others" >&2 &&
        tar -xzf "$part"/*.tar.gz -C "$part" --strip-components=3 --wildcards "$examples"seg.nii.gz "$examples"seg_dicom.nii.gz "${examples}ct_dicom/*"; then
        rm "$part"/*.tar.gz
        mv "$part" "$into"
    else
        rm -rf "$part"
        say 'these examples could not be had: label volumes of others are not checked'
    fi
}

mkdir -p target
exec 9>target/anatomy-lock
flock -n 9 || { say 'waiting for another set-up to finish'; flock 9; }
install_programs
[ "${1:-}" != others ] || get_others
say 'ready'
