# `make demo` and `make test` set everything up by themselves, in .venv.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
NATIVE := CMakeLists.txt $(shell find cpp -type f)

.PHONY: demo test test-all lint native-test docs clean

demo: $(VENV)/installed
	$(BIN)/monoloc demo

PYTEST := OMP_NUM_THREADS=1 $(BIN)/pytest --numprocesses logical --maxprocesses 4 --dist loadfile

test: lint docs native-test
	$(PYTEST) -m "not slow"

# Everything, the slow tests included, with coverage of lines and branches.
test-all: lint docs native-test
	$(PYTEST) --cov --cov-report term:skip-covered --cov-report html:build/coverage

docs: $(VENV)/installed
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --site-dir build/site

lint: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

native-test: $(VENV)/installed
	$(BIN)/cmake -S . -B build/cpp -DMONOLOC_BUILD_PYTHON=OFF -DMONOLOC_BUILD_TESTS=ON
	$(BIN)/cmake --build build/cpp -j 2
	$(BIN)/ctest --test-dir build/cpp --output-on-failure

$(VENV)/installed: pyproject.toml lab/pyproject.toml constraints.txt $(NATIVE)
	$(PYTHON) -m venv $(VENV)
	PIP_CONSTRAINT=constraints.txt $(BIN)/pip install --quiet --disable-pip-version-check --editable ".[dev]" --editable "lab[cluster,synth]"
	touch $@

clean:
	rm -rf build $(VENV)
