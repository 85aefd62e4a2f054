# Everything works in a fresh clone with python3 (3.11 or newer) and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
COMPILED := $(VENV)/.compiled

.PHONY: help setup demo results test lint format bench accuracy soak wheel clean

help:
	@echo "make demo      set up, then watch three simulated robots map a village"
	@echo "make results   run every scenario at full length, rewrite docs/results.md"
	@echo "make test      set up, then lint, types and all tests"
	@echo "make bench     time the kernels and the pipeline, side by side with NumPy, pandas and polars"
	@echo "make accuracy  measure against surveyed truth (needs TERRAFUSE_RECORDINGS)"
	@echo "make soak      long tests of real processes, 20,000 random schedules of the exchange: an hour"
	@echo "make wheel     build dist/*.whl"

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "terrafuse needs Python 3.11 or newer")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[all]" --group dev
	@touch $@

setup: $(READY)

# Kernels are compiled with their first use, about a minute in a fresh clone.
$(COMPILED): $(READY)
	$(BIN)/terrafuse demo --headless --duration 3 --out $(VENV)/demo >/dev/null
	@touch $@

demo: $(COMPILED)
	$(BIN)/terrafuse demo --headless --out demo

results: setup
	$(BIN)/python -m bench.results

test: lint
	$(BIN)/python -m pytest -n 2 --dist worksteal

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: setup
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: setup
	$(BIN)/python -m bench
	$(BIN)/python -m bench.capacity --robots 250 --seconds 10 --patience 10
	$(BIN)/python -m bench.exchange
	$(BIN)/python -m bench.mission
	$(BIN)/python -m bench.patrol
	$(BIN)/python -m bench.physics
	$(BIN)/python -m bench.plan
	$(BIN)/python -m bench.rays
	$(BIN)/python -m bench.simulate_rays
	$(BIN)/python -m bench.sonar
	$(BIN)/python -m bench.transport
	$(BIN)/python -m bench.wire

accuracy: setup
	$(BIN)/python -m tests.accuracy
	$(BIN)/python -m tests.accuracy_analytic
	$(BIN)/python -m tests.accuracy_terrain
	$(BIN)/python -m tests.accuracy_occupancy
	$(BIN)/python -m tests.accuracy_windows

soak: setup
	$(BIN)/python -m pytest -m long
	$(BIN)/python -m tests.exchange.soak

wheel: setup
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir dist .

clean:
	rm -rf $(VENV) dist demo results .hypothesis .mypy_cache .ruff_cache
