# Two commands do everything on a fresh machine: `make demo` and `make test`.
.PHONY: demo test build setup bench adversary clean

TROCAR := target/release/trocar

demo: build
	$(TROCAR) demo --out runs/demo

# Everything that can fail for a reason in this tree; the release binary is part of it, since debug and release must agree.
test: build
	cargo build --locked -p runtime
	cargo test --locked --workspace

build: setup
	cargo build --locked --release -p runtime

bench: setup
	cargo bench --locked -p tests

setup:
	@.ci/setup.sh

clean:
	cargo clean
	rm -rf runs
