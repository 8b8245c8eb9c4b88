# `make demo` and `make test` set everything up by themselves, in .venv.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
NATIVE := CMakeLists.txt $(shell find cpp -type f)

.PHONY: demo test lint native-test clean

demo: $(VENV)/installed
	$(BIN)/monoloc demo

test: lint native-test
	OMP_NUM_THREADS=1 $(BIN)/pytest --numprocesses logical --maxprocesses 4 --dist loadfile --no-loadscope-reorder

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
