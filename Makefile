# Two commands on a machine with Python, make and a package registry: `make demo`, `make test`.
PYTHON ?= python3
VENV ?= .venv
CONSTRAINTS ?= constraints.txt
BIN := $(VENV)/bin
# Idle workers take over tests from other workers. The compiled programs are shared on disk.
PYTEST := $(BIN)/python -m pytest -n 2 --dist worksteal

# The word after `evidence` is the name of a study, not a target.
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
	@echo "make test           install and run all tests except the slow ones, in a few minutes"
	@echo
	@echo "make check          run lint, types and the tests that compile nothing, within a minute"
	@echo "make test-slow      run the slow tests, which 'make test' omits"
	@echo "make test-all       run the tests of both in one session"
	@echo "make test-long      run the longest tests, such as studies and missions, before a release"
	@echo "make test-lowest    run the tests with the lowest versions that pyproject.toml allows"
	@echo "make test-python    run the tests with another Python: make test-python PYTHON=python3.13"
	@echo "make evidence NAME  run a long study and write to docs/evidence; without NAME, list the studies"
	@echo "make paper          write the paper's figures and tables to giajax-out/paper"
	@echo "make docs           build the documentation site in build/docs"
	@echo "make pictures       write the pictures and tables of the documentation"
	@echo "make lint           check formatting, lint and spelling"
	@echo "make types          check static types"
	@echo "make bench          measure the speed and compare it with MuJoCo, CasADi and scipy"
	@echo "make bench-check    measure and compare; fail if a ratio is a fifth below its recorded value"
	@echo "make synthetic      regenerate data/synthetic"
	@echo "make browser        install Chromium from the system packages, for the tests that open pages"

# One stamp file per set of extras, so a reinstallation happens only if the metadata change.
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

# One process, because a second one would have to import everything again.
quick: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m quick $(PYTEST_ARGS)

test: $(VENV)/.installed-dev
	$(PYTEST) -m "not slow and not long" $(PYTEST_ARGS)

test-slow: $(VENV)/.installed-dev
	$(PYTEST) -m slow $(PYTEST_ARGS)

test-long: $(VENV)/.installed-dev
	$(PYTEST) -m long $(PYTEST_ARGS)

# In one session, because the slow tests of a file use what its other tests have compiled.
test-all: $(VENV)/.installed-dev
	$(PYTEST) -m "not long" $(PYTEST_ARGS)

# Each uses its own environment. The static checks run only with the newest versions.
test-lowest:
	@$(MAKE) --no-print-directory quick test VENV=.venv-lowest CONSTRAINTS=constraints-lowest.txt

test-python:
	@$(MAKE) --no-print-directory quick test VENV=.venv-$(notdir $(PYTHON))

evidence: $(VENV)/.installed-dev
	$(BIN)/python -m evidence $(NAME) $(EVIDENCE_ARGS)

paper: $(VENV)/.installed
	$(BIN)/giajax paper all --out giajax-out/paper --force

# Warnings are errors, and every reference must be resolved.
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
