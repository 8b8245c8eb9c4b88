# `make demo` and `make test` set everything up by themselves, in .venv.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
NATIVE := CMakeLists.txt $(shell find cpp -type f)

# Some containers set it. Tests start many processes, each of which would compile every module anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo demo-bundle test test-all prepared quick-tests all-tests lint native-test sanitize fuzz release-files docs clean

demo: $(VENV)/installed
	$(BIN)/monoloc demo

# The bundle that `monoloc demo` flies with. Needed when the bundle's schema changes.
demo-bundle: $(VENV)/installed
	OMP_NUM_THREADS=1 $(BIN)/python -m monoloc_lab.make.demo_bundle

# Files in the order of their folders: those of tests/integration, the longest, come first, and no process waits long
# for another at the end.
PYTEST := OMP_NUM_THREADS=1 $(BIN)/pytest --numprocesses logical --maxprocesses 4 --dist loadfile \
	--no-loadscope-reorder

# Types take one processor for a minute, so they are checked beside the tests.
test: prepared
	$(MAKE) --no-print-directory --jobs 3 lint docs quick-tests

# The slow tests too, three times the examples of each property, and the coverage, which takes half as long again.
test-all: prepared
	$(MAKE) --no-print-directory --jobs 3 lint docs all-tests

# The core's own tests are compiled while pip installs, which takes one processor.
prepared:
	$(MAKE) --no-print-directory --jobs 2 --output-sync $(VENV)/installed native-test

quick-tests: $(VENV)/installed
	$(PYTEST) -m "not slow" --hypothesis-profile quick

all-tests: $(VENV)/installed
	$(PYTEST) --cov --cov-report html:build/coverage
	@echo "coverage of lines and branches: $$($(BIN)/coverage report --format total) %; see build/coverage"

docs: $(VENV)/installed
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --site-dir build/site

lint: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# Files of every kind, damaged on the way to new code in their readers; half an hour. RUNS is of each kind.
RUNS ?= 5000
fuzz: $(VENV)/installed
	PIP_CONSTRAINT=constraints.txt $(BIN)/pip install --quiet --disable-pip-version-check atheris
	OMP_NUM_THREADS=1 $(BIN)/python tests/fuzz/fuzz.py --runs $(RUNS)

native-test: $(BIN)/cmake
	$(BIN)/cmake -S . -B build/cpp -DMONOLOC_BUILD_PYTHON=OFF -DMONOLOC_BUILD_TESTS=ON
	$(BIN)/cmake --build build/cpp -j 2
	$(BIN)/ctest --test-dir build/cpp --output-on-failure

# The core's tests under the address and undefined-behaviour sanitizers.
sanitize: $(VENV)/installed
	$(BIN)/cmake -S . -B build/sanitized -DMONOLOC_BUILD_PYTHON=OFF -DMONOLOC_BUILD_TESTS=ON \
		-DCMAKE_BUILD_TYPE=Debug -DCMAKE_CXX_FLAGS="-fsanitize=undefined,address -fno-sanitize-recover=all -O1"
	$(BIN)/cmake --build build/sanitized -j 2
	$(BIN)/ctest --test-dir build/sanitized --output-on-failure

# What a drone installs, with the hashes of its files, and the same as a CycloneDX bill of materials.
release-files: $(VENV)/installed
	mkdir -p build/release
	$(BIN)/python -m monoloc_lab.make.release_requirements mavlink mcap sign > build/release/requirements.txt
	PIP_CONSTRAINT=constraints.txt $(BIN)/pip install --quiet --disable-pip-version-check cyclonedx-bom
	$(BIN)/cyclonedx-py requirements build/release/requirements.txt --output-file build/release/sbom.cdx.json

# pip of constraints.txt: that of Python 3.11 takes three times as long to choose versions.
$(BIN)/cmake:
	$(PYTHON) -m venv $(VENV)
	PIP_CONSTRAINT=constraints.txt $(BIN)/pip install --quiet --disable-pip-version-check --no-compile pip cmake

$(VENV)/installed: pyproject.toml lab/pyproject.toml constraints.txt $(NATIVE) | $(BIN)/cmake
	PIP_CONSTRAINT=constraints.txt $(BIN)/pip install --quiet --disable-pip-version-check --no-compile --editable ".[dev]" --editable "lab[cluster,synth,train]"
	touch $@

clean:
	rm -rf build $(VENV)
