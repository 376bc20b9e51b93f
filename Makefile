# Two commands on a machine with Python, make and a package registry: `make demo`, `make test`.
PYTHON ?= python3
VENV ?= .venv
CONSTRAINTS ?= constraints.txt
BIN := $(VENV)/bin
# Workers steal tests from each other at the end; the compiled programs are shared on disk.
PYTEST := $(BIN)/python -m pytest -n 2 --dist worksteal

# The word after `evidence` is the name of a study, and no target.
ifeq (evidence,$(firstword $(MAKECMDGOALS)))
NAME ?= $(word 2,$(MAKECMDGOALS))
ifneq (,$(NAME))
$(eval $(NAME):;@:)
endif
endif

.PHONY: help demo check quick test test-slow test-all test-long test-lowest test-python evidence \
	paper docs pictures lint types bench bench-check synthetic browser clean

help:
	@echo "make demo           install into $(VENV) and fit the demonstration run"
	@echo "make test           install and run the tests but the slow ones, in minutes"
	@echo
	@echo "make check          lint, types and the tests that compile nothing, within a minute"
	@echo "make test-slow      the tests that 'make test' leaves out"
	@echo "make test-all       both"
	@echo "make test-long      studies and benchmarks again, before a release"
	@echo "make test-lowest    the lowest versions that pyproject.toml allows"
	@echo "make test-python    another Python: make test-python PYTHON=python3.13"
	@echo "make evidence NAME  a study that takes long, into docs/evidence; without a name, lists them"
	@echo "make paper          the paper's figures and tables, into giajax-out/paper"
	@echo "make docs           the site of the documentation, into build/docs"
	@echo "make pictures       the pictures of the documentation, into docs/pictures, and its tables"
	@echo "make lint           formatting, lint and spelling"
	@echo "make types          static types"
	@echo "make bench          side-by-side measurements against MuJoCo, CasADi and scipy"
	@echo "make bench-check    the same, and fail where a ratio fell by a fifth since it was recorded"
	@echo "make synthetic      regenerate data/synthetic"
	@echo "make browser        Chromium from the system's packages, for the tests that open pages"

# A stamp per set of extras: installing again happens only when the project's metadata change.
$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml $(CONSTRAINTS) | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e . -c $(CONSTRAINTS)
	@touch $@

$(VENV)/.installed-dev: pyproject.toml $(CONSTRAINTS) | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]' -c $(CONSTRAINTS)
	@touch $@ $(VENV)/.installed

demo: $(VENV)/.installed
	$(BIN)/giajax fit --data data/synthetic/base_step.csv
	@echo
	@echo "giajax is installed in $(VENV). To use it in this terminal:"
	@echo "  . $(BIN)/activate && giajax --help"
	@echo "To write this fit as a page, and to open the page in a browser:"
	@echo "  $(BIN)/python -m pip install -e '.[report]' && $(BIN)/giajax report giajax-out/base_step"
	@echo "  $(BIN)/python -m webbrowser 'file://$(CURDIR)/giajax-out/base_step/report.html'"

check: $(VENV)/.installed-dev
	@$(MAKE) --no-print-directory --jobs=2 --keep-going lint types quick

# One process: a second one would import everything again.
quick: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m quick $(PYTEST_ARGS)

test: $(VENV)/.installed-dev
	$(PYTEST) -m "not slow and not long" $(PYTEST_ARGS)

test-slow: $(VENV)/.installed-dev
	$(PYTEST) -m slow $(PYTEST_ARGS)

test-long: $(VENV)/.installed-dev
	$(PYTEST) -m long $(PYTEST_ARGS)

# What is slow is run even where something else failed, and is not run twice.
test-all: $(VENV)/.installed-dev
	@$(MAKE) --no-print-directory --keep-going test test-slow

# An environment of its own for each; the static tools are those of the newest versions.
test-lowest:
	@$(MAKE) --no-print-directory quick test VENV=.venv-lowest CONSTRAINTS=constraints-lowest.txt

test-python:
	@$(MAKE) --no-print-directory quick test VENV=.venv-$(notdir $(PYTHON))

evidence: $(VENV)/.installed-dev
	$(BIN)/python -m evidence $(NAME) $(EVIDENCE_ARGS)

paper: $(VENV)/.installed
	$(BIN)/giajax paper all --out giajax-out/paper --force

# Warnings are errors, and every reference must lead somewhere.
docs: $(VENV)/.installed-dev
	$(BIN)/python -m sphinx -b html -W --keep-going -n -q docs build/docs
	@echo "open build/docs/index.html"

pictures: $(VENV)/.installed-dev
	$(BIN)/python -m docs.machinery.tables
	$(BIN)/python -m docs.machinery.pictures

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/codespell

types: $(VENV)/.installed-dev
	$(BIN)/mypy

bench: $(VENV)/.installed-dev
	$(BIN)/python -m benchmarks.bench $(BENCH_ARGS)
	$(BIN)/python -m benchmarks.options
	$(BIN)/python -m benchmarks.hysteresis
	$(BIN)/python -m benchmarks.commands

bench-check: $(VENV)/.installed-dev
	$(BIN)/python -m benchmarks.bench --check $(BENCH_ARGS)

synthetic: $(VENV)/.installed
	$(BIN)/python data/synthetic/regenerate.py

browser:
	tests/install-browser

clean:
	rm -rf $(VENV) .venv-* .jax_cache .pytest_cache .mypy_cache .ruff_cache build dist docs/_generated
