# Two commands on a machine with Python, make and a package registry: `make demo`, `make test`.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin

.PHONY: help demo test lint types bench synthetic clean

help:
	@echo "make demo       install into $(VENV) and fit the demonstration run"
	@echo "make test       install and run the tests"
	@echo "make lint       formatting and lint"
	@echo "make types      static types"
	@echo "make bench      side-by-side measurements against MuJoCo and scipy"
	@echo "make synthetic  regenerate data/synthetic"

# A stamp per set of extras: installing again happens only when the project's metadata change.
$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e . -c constraints.txt
	@touch $@

$(VENV)/.installed-dev: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]' -c constraints.txt
	@touch $@ $(VENV)/.installed

demo: $(VENV)/.installed
	$(BIN)/giajax fit --data data/synthetic/base_step.csv

test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n 2 $(PYTEST_ARGS)

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.installed-dev
	$(BIN)/mypy

bench: $(VENV)/.installed-dev
	$(BIN)/python benchmarks/bench.py $(BENCH_ARGS)
	$(BIN)/python benchmarks/options.py
	$(BIN)/python benchmarks/hysteresis.py

synthetic: $(VENV)/.installed
	$(BIN)/python data/synthetic/regenerate.py

clean:
	rm -rf $(VENV) .jax_cache .pytest_cache .mypy_cache .ruff_cache build dist
