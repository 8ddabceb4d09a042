# Two commands do everything on a fresh machine: `make demo` and `make test`.
.PHONY: demo dist test-dist test check test-units test-clockless test-waiting test-beside test-adversary test-golden test-can test-python test-foxglove test-study test-console test-anatomy test-anatomy-short test-slurm adversary fuzz-can build setup setup-can setup-browser setup-python bench clean

TROCAR := $(or $(CARGO_TARGET_DIR),target)/release/trocar
DEBUG_TROCAR := $(or $(CARGO_TARGET_DIR),target)/debug/trocar
PYTHON := $(CURDIR)/target/python/bin/python

# Set but empty means not set; cargo would take it for a folder.
ifeq ($(strip $(LIBTORCH)),)
unexport LIBTORCH
endif

# Mesa's Wayland probe complains about its absence in every program that renders.
export XDG_RUNTIME_DIR ?= /tmp

demo: build
	$(TROCAR) demo --out runs/demo

# Integration tests that read no clock: lockstep, files, arithmetic.
CLOCKLESS := anatomy bad_input compute determinism ensembling evaluation import lockstep recording scene_file task_folder training views

# Everything that can fail for a reason in this tree; the release binary is part of it, since debug and release must agree. Tests on a
# bus and of the Python package mostly wait, so whatever needs no clock runs beside them in what they leave of the cores; what runs in real time comes afterwards,
# alone and at half speed.
test: setup
	cargo build --locked -p trocar
	cargo test --locked --workspace --tests --no-run
	$(MAKE) -j2 --output-sync=target test-waiting test-beside
	SKIP="$(CLOCKLESS)" TROCAR_SLOW_MOTION=2 cargo test --locked --workspace --test '*' --config 'target."cfg(all())".runner=["$(CURDIR)/.ci/unless"]'
	$(MAKE) test-study
	$(MAKE) test-console

test-waiting: setup
	$(MAKE) test-can
	$(MAKE) test-python
	$(MAKE) test-anatomy-short

test-beside: setup
	nice -n 19 cargo build --locked --release -p trocar
	nice -n 19 $(MAKE) -j2 --output-sync=target test-units test-clockless
	nice -n 19 cargo test --locked --workspace --doc

test-units: setup
	cargo test --locked --workspace --lib

test-clockless: build
	cargo test --locked --workspace $(CLOCKLESS:%=--test %)

# Format, lints and unit tests of the crates that differ from HEAD: for the time while you work.
check: setup
	.ci/check

# Adversaries, planted faults and scenarios for the safety chain, alone; part of the workspace's tests.
test-adversary: setup
	cargo test --locked -p trocar-control --lib

# What needs a CAN bus, where there is one: in user-mode Linux if this machine's kernel has none. Without either, this fails.
test-can: setup setup-can
	cargo build --locked -p trocar
	cargo test --locked --workspace --test can_bus --config 'target."cfg(all())".runner=["$(CURDIR)/.ci/on-vcan"]' -- --ignored

# The Python package: types, and its policies and environments against the debug binary, in a virtual environment in target/python.
test-python: setup setup-python
	cargo build --locked -p trocar
	cd policy/python && $(PYTHON) -m mypy --cache-dir $(CURDIR)/target/mypy
	cd policy/python && TROCAR=$(abspath $(DEBUG_TROCAR)) $(PYTHON) -B -m pytest -q -p no:cacheprovider

# What runs and logs tell Foxglove, read with its Python SDK and MCAP's; part of `make test-python`.
test-foxglove: setup setup-python
	cargo build --locked -p trocar
	cd policy/python && TROCAR=$(abspath $(DEBUG_TROCAR)) $(PYTHON) -B -m pytest -q -p no:cacheprovider tests/test_foxglove.py

# A tiny study interrupted, killed, gone on with, in two shards, reported, its page opened in a browser.
test-study: build setup-browser
	cargo test --locked --workspace --test study -- --include-ignored

# The web console in a browser: it shows and steers a run, comes back after a cut, fits its window; pictures of it in target/scratch. One
# browser at a time: hands that come late are let go.
test-console: setup setup-browser
	cargo build --locked -p trocar
	cargo test --locked --workspace --test console -- --ignored --test-threads=1

# Patients of scans: what nibabel, SimpleITK, trimesh, usd-core and the Khronos glTF validator say of a small phantom's meshes.
test-anatomy-short: setup
	@.ci/setup-anatomy.sh
	cargo build --locked -p trocar
	TROCAR=$(abspath $(DEBUG_TROCAR)) target/anatomy/bin/python -B tests/scripts/anatomy.py --short target/scratch/anatomy-short

# The same of a larger one, and foreign stages, a DICOM series, label volumes of others; the crate's tests. Not part of `make test`.
test-anatomy: setup
	@.ci/setup-anatomy.sh others
	cargo test --locked -p trocar-anatomy
	cargo build --locked -p trocar
	TROCAR=$(abspath $(DEBUG_TROCAR)) target/anatomy/bin/python -B tests/scripts/anatomy.py target/scratch/anatomy

# The Slurm array script on a cluster of this one machine: installs slurm-wlm, needs root, and is no part of `make test`.
test-slurm: build
	tests/scripts/slurm_one_machine.sh

# The networks against the numbers of the reference implementations in TROCAR_GOLDEN, or in tests/golden/policies.json.
test-golden: setup
	cargo test --locked --workspace --test golden -- --nocapture

# The same adversaries for ten million ticks each, with their figures.
adversary: setup
	TROCAR_ADVERSARY_TICKS=10000000 cargo test --locked --release -p trocar-control --lib tests::adversary:: -- --nocapture

# Ten million arbitrary frames on the bus of an arm, and as many at a single drive, with figures.
fuzz-can:
	cargo test --locked --release -p trocar-drives --test can_fuzz -- --ignored --nocapture

# An archive that runs from wherever it is unpacked, and Debian packages, in target/dist.
dist: build
	.ci/dist

# What `make dist` made, in a bare Debian root as an unprivileged user: needs root and a Debian mirror, and is no part of `make test`.
test-dist: dist
	tests/scripts/dist_in_bare_debian.sh

build: setup
	cargo build --locked --release -p trocar

bench: setup
	cargo bench --locked -p tests

setup:
	@.ci/setup.sh

# Only the CAN tests need what this installs.
setup-can:
	@.ci/setup-can.sh

# Only the tests of reports and of the console need what this installs.
setup-browser:
	@.ci/setup-browser.sh

# Only the tests of the Python package need what this installs.
setup-python:
	@.ci/setup-python.sh

clean:
	cargo clean
	rm -rf runs
