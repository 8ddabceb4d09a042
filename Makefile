# Two commands do everything on a fresh machine: `make demo` and `make test`.
.PHONY: checked demo dist test-dist test check test-units test-clocked test-clockless test-in-turn test-beside test-beside-short test-beside-long test-adversary test-golden test-can test-python test-python-clocked test-python-clockless test-foxglove test-lerobot test-study test-console test-console-live test-console-replayed test-anatomy test-anatomy-short test-release test-slurm adversary fuzz-can build setup setup-can setup-browser setup-python setup-anatomy setup-lerobot bench clean

TARGET := $(abspath $(or $(CARGO_TARGET_DIR),target))
TROCAR := $(TARGET)/release/trocar
# What tests run that does not have to be a user's binary: the same with assertions.
TROCAR_CHECKED := $(TARGET)/checked/trocar
CARGO := .ci/checked
PYTHON := $(CURDIR)/target/python/bin/python
PYTEST = cd policy/python && TROCAR=$(TROCAR_CHECKED) $(PYTHON) -B -m pytest -q -p no:cacheprovider

# Set but empty means not set; cargo would take it for a folder.
ifeq ($(strip $(LIBTORCH)),)
unexport LIBTORCH
endif

# Mesa's Wayland probe complains about its absence in every program that renders.
export XDG_RUNTIME_DIR ?= /tmp

demo: build
	$(TROCAR) demo --out runs/demo

# Integration tests that read no clock: lockstep, files, arithmetic.
CLOCKLESS := anatomy architecture bad_input can_fuzz can_refusals can_sync command_line compute conformance determinism ensembling evaluation golden hostile import lockstep master no_alloc peer recording scene_file task_folder training views

# Of the tests in the files console and examples those that read none, by parts of their names: the console on logs, datasets and recordings
# by the expert, and examples in lockstep.
REPLAYED := dataset:: log:: replayed:: browser::the_page_follows_a_recording recorded::a_recording_tells
CLOCKLESS_PARTS := in_lockstep:: $(REPLAYED)

# Unit tests that read a clock.
CLOCKED := session::realtime::

# Benches and examples are linted where our crates are.
LINTED := $(if $(filter 1,$(TROCAR_LINT)),--bench '*' --examples)

# Everything that can fail for a reason in this tree, of a release with assertions. What reads a clock, or waits for a bus or a person's
# hands, runs in turn; what needs no clock has the processor time that they leave, and so has the compiler once the first of them,
# which mostly wait for their bus, are there.
test: setup setup-can setup-python setup-anatomy setup-browser checked
	$(CARGO) test --workspace --test can_bus --no-run
	$(MAKE) -j2 --output-sync=target test-in-turn test-beside

test-in-turn:
	$(MAKE) test-can
	$(MAKE) test-python-clocked
	$(MAKE) test-clocked
	$(MAKE) test-console-live

# One cargo at a time: until the CAN tests run.
test-beside:
	sleep 20
	.ci/idle $(CARGO) test --workspace --tests $(LINTED) --no-run
	.ci/idle $(MAKE) -j2 --output-sync=target test-beside-short test-beside-long

test-beside-short:
	$(MAKE) test-units
	$(MAKE) test-clockless

# What one core does alone for minutes. What has limits of time, wide ones, comes first: browsers and runs in turn leave least at the end.
test-beside-long:
	$(MAKE) test-study
	$(MAKE) test-console-replayed
	$(MAKE) test-python-clockless
	$(MAKE) test-anatomy-short
	$(CARGO) test --workspace --doc

test-units: setup
	$(CARGO) test --workspace --lib -- --skip $(CLOCKED)

# In real time, at half speed.
test-clocked: setup checked
	$(CARGO) test -p trocar --lib $(CLOCKED)
	SKIP="$(CLOCKLESS) study console examples" TROCAR_SLOW_MOTION=2 $(CARGO) test --workspace --test '*' --config 'target."cfg(all())".runner=["$(CURDIR)/.ci/unless"]'
	TROCAR_SLOW_MOTION=2 $(CARGO) test --workspace --test console --test examples -- $(CLOCKLESS_PARTS:%=--skip %)

test-clockless: setup checked
	$(CARGO) test --workspace $(CLOCKLESS:%=--test %)
	$(CARGO) test --workspace --test console --test examples -- $(CLOCKLESS_PARTS)

# The binary that users get moves as the one with assertions does. Not part of `make test`.
test-release: checked build
	$(CARGO) test --workspace --test lockstep -- --ignored

# Format, lints and unit tests of the crates that differ from HEAD: for the time while you work.
check: setup
	.ci/check

# Adversaries, planted faults and scenarios for the safety chain, alone; part of the workspace's tests.
test-adversary: setup
	$(CARGO) test -p trocar-control --lib

# What needs a CAN bus, where there is one: in user-mode Linux if this machine's kernel has none. Without either, this fails.
test-can: setup setup-can checked
	$(CARGO) test --workspace --test can_bus --config 'target."cfg(all())".runner=["$(CURDIR)/.ci/on-vcan"]' -- --ignored

# The Python package: types, and its policies and environments in a virtual environment in target/python. One
# half after the other, whatever -j says.
test-python:
	$(MAKE) test-python-clockless
	$(MAKE) test-python-clocked

# What runs in real time, or waits until a time is over.
test-python-clocked: setup setup-python checked
	$(PYTEST) -m clock

test-python-clockless: setup setup-python checked
	cd policy/python && $(PYTHON) -m mypy --cache-dir $(CURDIR)/target/mypy
	$(PYTEST) -m 'not clock'

# What runs and logs tell Foxglove, read with its Python SDK and MCAP's; part of `make test-python`.
test-foxglove: setup setup-python checked
	$(PYTEST) tests/test_foxglove.py

# The plug-in in LeRobot's own registry and rollout, and committed policies run by LeRobot's classes beside our engine. Wants Python 3.12 and
# installs 5.5 GB, so it is no part of `make test`.
test-lerobot: setup setup-lerobot checked
	cd policy/python && TROCAR=$(TROCAR_CHECKED) $(CURDIR)/target/lerobot/bin/python -B -m pytest -q -p no:cacheprovider tests/test_lerobot.py tests/test_lerobot_env.py tests/test_lerobot_twin.py

# A tiny study interrupted, killed, gone on with, in two shards, reported, its page opened in a browser.
test-study: setup setup-browser checked
	$(CARGO) test --workspace --test study -- --include-ignored

# The web console in a browser: it shows and steers a run, comes back after a cut, fits its window; pictures of it in target/scratch. One
# of its tests at a time, whatever -j says: hands that come late are let go.
test-console:
	$(MAKE) test-console-replayed
	$(MAKE) test-console-live

test-console-live: setup setup-browser checked
	$(CARGO) test --workspace --test console -- --ignored --test-threads=1 $(REPLAYED:%=--skip %)

# Those that read no clock.
test-console-replayed: setup setup-browser checked
	$(CARGO) test --workspace --test console -- --ignored --test-threads=1 $(REPLAYED)

# Patients of scans: what nibabel, SimpleITK, trimesh, usd-core and the Khronos glTF validator say of a small phantom's meshes.
test-anatomy-short: setup setup-anatomy checked
	TROCAR=$(TROCAR_CHECKED) target/anatomy/bin/python -B tests/scripts/anatomy.py --short target/scratch/anatomy-short

# The same of a larger one, and foreign stages, a DICOM series, label volumes of others; the crate's tests, a thousand phantoms and the
# meshes of twenty among them. Not part of `make test`.
test-anatomy: setup checked
	@.ci/setup-anatomy.sh others
	$(CARGO) test -p trocar-anatomy -- --include-ignored
	TROCAR=$(TROCAR_CHECKED) target/anatomy/bin/python -B tests/scripts/anatomy.py target/scratch/anatomy

# The Slurm array script on a cluster of this one machine: installs slurm-wlm, needs root, and is no part of `make test`.
test-slurm: build
	tests/scripts/slurm_one_machine.sh

# The networks against the numbers of the reference implementations in TROCAR_GOLDEN, or in tests/golden/policies.json.
test-golden: setup
	$(CARGO) test --workspace --test golden -- --nocapture

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

checked: setup
	$(CARGO) build -p trocar
	@ln -f $(TARGET)/checked/release/trocar $(TROCAR_CHECKED)

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

# Only the tests of patients' meshes need what this installs.
setup-anatomy:
	@.ci/setup-anatomy.sh

# Only the tests with LeRobot need what this installs.
setup-lerobot:
	@.ci/setup-lerobot.sh

clean:
	cargo clean
	rm -rf runs
