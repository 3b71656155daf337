# Everything a person or the continuous integration runs.

CARGO ?= cargo
PYTHON ?= python3
TRAINING_PYTHON ?= $(PYTHON)
VENV := .venv
# One choice of packages for all tests: any other asks for other features of their dependencies, and compiles most of it again.
WORKSPACE := --workspace --exclude svbrdf-gcn-benches
# Where Cargo puts what it builds.
TARGET := $(or $(CARGO_TARGET_DIR),target)
BIN := $(TARGET)/release/svbrdf-gcn
# The Cargo profile of the wheel: dev compiles faster, and shares what the tests compiled.
PROFILE ?= release

# Where the measuring data lies beside the repository, no test may skip for want of it.
ifneq ($(wildcard ../shared/REFERENCE.md),)
export SVBRDF_GCN_REQUIRE_SHARED := 1
endif

# Property tests draw the same cases every time; another seed draws others.
export PROPTEST_RNG_SEED ?= 1

.PHONY: help build demo phone test setup lint unit docs-test c-test asan header install python-build python-test mutations golden blender-test oiio-test training-test stubs wheel addon bench accuracy trade ablations fuzz sample phone-proof phone-sample clean

help: ## this list
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## */\t/' | expand -t 14

# Both at once: alone, the libraries would ask for fewer features and compile everything again.
build: ## the command line and the C libraries, optimised
	$(CARGO) build --release --locked -p svbrdf-gcn -p svbrdf-gcn-ffi

demo: build ## fit the sample capture and show where the pictures are
	@$(BIN) fit samples/tiles --views 0,1,2,3,4,5,6 -o out/demo
	@$(BIN) evaluate out/demo samples/tiles --views 7,8 --truth samples/tiles/truth
	@echo "Look at out/demo/preview.png"

phone: build ## photos of a printed sheet to maps, and where the pictures are
	@$(BIN) fit samples/phone/*.jpg --depth 1mm --light-offset auto -o out/phone
	@echo "Look at out/phone/capture/contact-sheet.png and out/phone/preview.png"

# What only rebuilds need is not kept.
test: export CARGO_INCREMENTAL := 0
test: setup lint unit docs-test c-test python-build python-test training-test golden blender-test ## set up what the tests need, and run them all, cheapest first

setup: ## Python packages in .venv
	@tools/setup.sh

lint: ## formatting, clippy, documentation
	$(CARGO) fmt --all --check
	$(CARGO) clippy --workspace --all-targets --locked -- -D warnings
	RUSTDOCFLAGS="-D warnings" $(CARGO) doc --workspace --no-deps --locked

unit: ## Rust tests, also against OpenImageIO
	$(CARGO) check -p svbrdf-gcn --no-default-features --locked
	$(CARGO) test $(WORKSPACE) --tests --locked

docs-test: ## the examples in the documentation
	$(CARGO) test $(WORKSPACE) --doc --locked

c-test: ## C and C++: interface, installed library, examples, sanitizers, valgrind
	$(CARGO) build $(WORKSPACE) --lib --bins --test header --locked
	rm -rf $(TARGET)/c
	tools/install.sh $(TARGET)/debug $(TARGET)/c/prefix
	tests/c/run.sh $(TARGET)/c/prefix

asan: ## the C and C++ tests with the library under AddressSanitizer too (minutes; compiles everything)
	RUSTC_BOOTSTRAP=1 RUSTFLAGS=-Zsanitizer=address $(CARGO) build -p svbrdf-gcn-ffi --locked --target x86_64-unknown-linux-gnu --target-dir $(TARGET)/asan
	rm -rf $(TARGET)/c-asan
	tools/install.sh $(TARGET)/asan/x86_64-unknown-linux-gnu/debug $(TARGET)/c-asan/prefix
	ASAN=1 tests/c/run.sh $(TARGET)/c-asan/prefix

header: ## write include/svbrdf_gcn/svbrdf_gcn.h anew
	SVBRDF_GCN_WRITE_HEADER=1 $(CARGO) test $(WORKSPACE) --test header --locked

PREFIX ?= /usr/local
install: build ## libraries, headers, pkg-config and CMake files to PREFIX (and DESTDIR)
	tools/install.sh $(TARGET)/release "$(DESTDIR)$(PREFIX)"

# The builder of Python packages, in an environment of its own: it needs nothing that the tests need.
MATURIN := $(VENV)/maturin/bin/maturin
$(MATURIN): python/requirements.txt
	$(PYTHON) -m venv $(VENV)/maturin
	$(VENV)/maturin/bin/pip install --quiet --disable-pip-version-check -r $<
	touch $@

PACKAGE := --manifest-path python/Cargo.toml --locked
WHEELS := $(abspath $(TARGET))/wheels

python-build: $(MATURIN) ## the Python package, installed in .venv; its stubs must be those that `make stubs` writes
	rm -rf $(WHEELS) $(TARGET)/stubs
	$(MATURIN) build $(PACKAGE) --profile dev --out $(WHEELS)
	$(MATURIN) generate-stubs $(PACKAGE) --profile dev --out $(TARGET)/stubs
	diff -u python/svbrdf_gcn/_svbrdf_gcn.pyi $(TARGET)/stubs/svbrdf_gcn/_svbrdf_gcn.pyi
	$(VENV)/bin/pip install --quiet --disable-pip-version-check --force-reinstall --no-deps $(WHEELS)/*.whl
	$(VENV)/numpy1/bin/pip install --quiet --disable-pip-version-check --force-reinstall --no-deps $(WHEELS)/*.whl

stubs: $(MATURIN) ## write the types of the Python package anew
	$(MATURIN) generate-stubs $(PACKAGE) --profile dev --out python

wheel: $(MATURIN) ## the Python package as a wheel in dist (PROFILE=dev for a quick one)
	rm -f dist/*.whl
	$(MATURIN) build $(PACKAGE) --profile $(PROFILE) --strip --out dist

python-test: ## Python package and tools
	$(VENV)/bin/python -m pytest -q -n auto --dist worksteal --durations 12 tests/python
	SVBRDF_GCN_NUMPY=1.26 $(VENV)/numpy1/bin/python -m pytest -q -n auto --dist worksteal tests/python/test_package.py

mutations: ## 5,000 damaged captures, photos, materials and weights; after python-build (make test has 200 of another seed)
	$(VENV)/bin/python tests/mutations/mutations.py

golden: ## one capture, the same files from every language; after c-test and python-build
	SVBRDF_GCN_WHEEL=$$(ls $(WHEELS)/*.whl) $(VENV)/bin/python tests/golden/compare.py $(TARGET)/golden cli=$(TARGET)/debug/svbrdf-gcn c=$(TARGET)/c/tests/golden-c cpp=$(TARGET)/c/tests/golden-cpp \
		"python=$(VENV)/bin/python tests/golden/fit.py" "blender=$(VENV)/blender/bin/python tests/golden/fit_blender.py"

training-test: ## the trainer, after python-build, where TRAINING_PYTHON has PyTorch, numpy and Pillow; else it says that it is skipped
	@if $(TRAINING_PYTHON) -c "import torch, numpy, PIL" 2> $(TARGET)/training-needs; then \
		$(TRAINING_PYTHON) -m pip install --quiet --disable-pip-version-check --upgrade --target $(VENV)/training pytest && \
		$(TRAINING_PYTHON) -m pip install --quiet --disable-pip-version-check --upgrade --no-deps --target $(VENV)/training $(WHEELS)/*.whl && \
		PYTHONPATH=$(abspath $(VENV))/training $(TRAINING_PYTHON) -m pytest -q -rs tests/training; \
	else \
		echo "SKIPPED: tests/training: $(TRAINING_PYTHON): $$(tail -1 $(TARGET)/training-needs); TRAINING_PYTHON=... names a Python that has PyTorch, numpy and Pillow"; \
	fi

blender-test: ## the extension, in Blender's Python module
	SVBRDF_GCN_WHEEL=$$(ls $(WHEELS)/*.whl) $(VENV)/blender/bin/python -m pytest -q tests/blender

addon: wheel ## the Blender extension in dist
	$(VENV)/maturin/bin/python python/tools/build_addon.py dist/*.whl -o dist

oiio-test: ## readers, writers and colours against OpenImageIO (part of unit)
	$(CARGO) test $(WORKSPACE) --test files --locked

bench: ## benchmarks; figures are in docs/performance.md
	$(CARGO) bench -p svbrdf-gcn-benches

ACCURACY_PYTHON := $(VENV)/accuracy/bin/python
$(VENV)/accuracy/requirements.txt: tests/accuracy/requirements.txt
	@[ -x $(ACCURACY_PYTHON) ] || $(PYTHON) -m venv $(VENV)/accuracy
	$(VENV)/accuracy/bin/pip install --quiet --disable-pip-version-check --no-deps -r $<
	cp $< $@

# ACCURACY are arguments of the script: ACCURACY=--quick, ACCURACY=--report-only, ...
accuracy: build $(VENV)/accuracy/requirements.txt ## fit materials and captures whose truth is known and write docs/accuracy.md (needs the measuring data; hours)
	$(ACCURACY_PYTHON) -m pytest -q tests/accuracy
	$(ACCURACY_PYTHON) tests/accuracy/accuracy.py --binary $(BIN) $(ACCURACY)

# TRADE are arguments of the script: TRADE="--count 2", ...
trade: build $(VENV)/accuracy/requirements.txt ## what time and memory buy, one option at a time, and write docs/trade.md (needs the measuring data; an hour)
	$(ACCURACY_PYTHON) tests/accuracy/trade.py --binary $(BIN) $(TRADE)

ablations: build $(VENV)/accuracy/requirements.txt ## measure the trainings of svbrdf_gcn.training.ablations in out/ablations and write docs/ablations.md (after make accuracy)
	$(ACCURACY_PYTHON) tests/accuracy/ablations.py out/ablations --binary $(BIN)

FUZZ_SECONDS ?= 60
fuzz: ## a minute (FUZZ_SECONDS) on each reader and on the C interface (needs cargo-fuzz)
	for target in image folders weights training_packs c_interface; do \
		mkdir -p fuzz/corpus/$$target fuzz/seeds/$$target; \
		RUSTC_BOOTSTRAP=1 $(CARGO) fuzz run -O $$target fuzz/corpus/$$target fuzz/seeds/$$target -- -max_total_time=$(FUZZ_SECONDS) -malloc_limit_mb=1200 -max_len=65536 || exit 1; \
	done

sample: setup ## path-trace the sample captures again
	$(VENV)/blender/bin/python python/tools/make_sample.py samples

phone-proof: ## how near acquire comes, on photos made by numpy; after python-build (docs/capturing.md)
	$(VENV)/bin/python python/tools/phone_proof.py

phone-sample: setup build ## path-trace the telephone's photos of the printed sheet again
	mkdir -p out && $(BIN) sheet -o out/sheet.pdf
	$(VENV)/bin/python python/tools/make_phone.py samples/phone --pdf out/sheet.pdf

clean: ## remove what was built
	$(CARGO) clean
	rm -rf out dist $(VENV)
