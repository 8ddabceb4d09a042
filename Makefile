# Two commands do everything on a fresh machine: `make demo` and `make test`.
.PHONY: demo test test-adversary test-golden adversary build setup bench clean

TROCAR := $(or $(CARGO_TARGET_DIR),target)/release/trocar

# Set but empty means not set; cargo would take it for a folder.
ifeq ($(strip $(LIBTORCH)),)
unexport LIBTORCH
endif

# Mesa's Wayland probe complains about its absence in every program that renders.
export XDG_RUNTIME_DIR ?= /tmp

demo: build
	$(TROCAR) demo --out runs/demo

# Everything that can fail for a reason in this tree; the release binary is part of it, since debug and release must agree.
test: build
	cargo build --locked -p runtime
	cargo test --locked --workspace
	$(MAKE) test-adversary

# Adversaries, planted faults and scenarios for the safety chain: too long for a debug build.
test-adversary: setup
	cargo test --locked --release -p runtime --lib control::tests::
	cargo test --locked --release -p tests --test no_alloc

# The networks against the numbers of the reference implementations in TROCAR_GOLDEN, or in tests/golden/policies.json.
test-golden: setup
	cargo test --locked --workspace --test golden -- --nocapture

# The same adversaries for ten million ticks each, with their figures.
adversary: setup
	TROCAR_ADVERSARY_TICKS=10000000 cargo test --locked --release -p runtime --lib control::tests::adversary:: -- --nocapture

build: setup
	cargo build --locked --release -p runtime

bench: setup
	cargo bench --locked -p tests

setup:
	@.ci/setup.sh

clean:
	cargo clean
	rm -rf runs
