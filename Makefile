# Every target sets up what it needs: a virtual environment in .venv, with the project in it.

PYTHON ?= python3

# A Python that is named and is not the version of .venv has a virtual environment of its own, such
# as .venv-3.12.
EXISTING := $(shell sed -n 's/^version[a-z_]* *= *\([0-9]*\.[0-9]*\).*/\1/p' .venv/pyvenv.cfg 2> /dev/null)
ifeq ($(origin PYTHON),file)
VENV := .venv
else
NAMED := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2> /dev/null)
VENV := $(if $(filter-out $(NAMED),$(EXISTING)),.venv-$(NAMED),.venv)
endif
BIN := $(VENV)/bin
LOWEST := .venv-lowest
# uv needs a fifth of pip's time. Without uv, or if uv finds no index (it does not read pip's
# settings), pip installs. `make UV=` installs with pip.
UV ?= $(shell command -v uv 2> /dev/null)
# $(call install,PYTHON,OPTIONS) installs packages into the environment of a Python.
install = $(if $(UV),$(UV) pip install --quiet --python $(1) $(2) || )\
  $(BIN)/python -m pip --python $(1) install --quiet $(2)
# Robots of other packages: the tests read their files.
ROBOTS := build/robots
# Converters to USD depend on another OpenUSD than the project's.
CONVERTERS := build/converters
# Quick ones, which between them use every package that is required.
LOWEST_TESTS := $(addprefix tests/,$(addsuffix .py,base/test_results cli/test_shared \
  models/test_loading present/test_figures present/test_printed tools/crosscheck/test_crosscheck robot/test_robot \
  simulation/test_verify statics/test_equilibrium tools/audit/test_document tools/study/test_document \
  tools/study/test_outcome tools/study/test_running tools/study/test_study))
# Number of inputs of the fuzzer, and more options of tests/fuzz.py.
N ?= 2000
FUZZ ?=
# Number of pairs that `make explore` draws, and the seed.
PAIRS ?= 20
SEED ?= 1
# The timeout guards against hanging: it is ten times what the longest test needs. The method
# "thread" also ends a process that hangs in compiled code.
PYTEST := $(BIN)/python -m pytest --timeout=600 --timeout-method=thread
MINOR := $(shell sed -n 's/^requires-python = ">=3\.\([0-9]*\)".*/\1/p' pyproject.toml)

# What else is installed on the machine stays out of the way.
export PYTHONNOUSERSITE := 1
unexport PYTHONPATH PYTHONHOME
# Tests start many processes: each would compile the package anew.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help setup setup-quick setup-ci analyze test test-slow test-lowest test-all fuzz explore coverage benchmark benchmark-quick benchmark-ratios lint types docs docs-links wheel dist clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-15s  %s\n", $$1, $$2}' Makefile

setup: $(VENV)/.ready ## only set up the virtual environment

setup-quick: $(VENV)/.ready-ci $(ROBOTS)/.ready ## install what the quick tests need, so that none is skipped
	.ci/system

setup-ci: setup-quick $(VENV)/.ready-torch $(CONVERTERS)/.ready ## install what all tests need, so that none is skipped

analyze: $(VENV)/.ready ## analyse all variants; figures go to output/
	@# Status 1: a variant fails, as v3-long-leg does on its own servos. The output names it.
	$(BIN)/python scripts/analyze_variant.py || [ $$? -eq 1 ]

test: $(VENV)/.ready ## run the quick tests: a minute
	$(PYTEST)

test-all: $(VENV)/.ready ## run all tests
	$(PYTEST) tests

test-slow: $(VENV)/.ready ## run the tests that make test leaves out
	$(PYTEST) -m slow

test-lowest: $(LOWEST)/.ready ## run quick tests with the lowest versions that are allowed
	$(LOWEST)/bin/python -m pytest -m "not slow" -W ignore::DeprecationWarning $(LOWEST_TESTS)

fuzz: $(VENV)/.ready ## spoil N files and commands; no traceback, hang or lost file may come of it
	$(BIN)/python tests/damaged.py 500
	$(BIN)/python tests/fuzz.py $(N) $(FUZZ)

explore: $(VENV)/.ready ## compare PAIRS pairs of an edited file and a command with bare MuJoCo
	$(BIN)/python -m tests.explore $(PAIRS) --seed $(SEED)

coverage: $(VENV)/.ready-dev ## run the tests, and say which lines they leave out
	$(BIN)/python -m pytest tests --cov --cov-report=term-missing:skip-covered

benchmark: $(VENV)/.ready-benchmark ## measure against the bare engines and peers
	$(BIN)/python benchmarks/run.py --json build/benchmarks.json --tables docs/data \
	  --figure build/growth.png $(BENCHMARK)

benchmark-quick: $(VENV)/.ready-benchmark ## only check that benchmarks and peers agree
	$(BIN)/python benchmarks/run.py --quick

benchmark-ratios: $(VENV)/.ready ## compare the time of calls, in times of the bare engines', with docs/data
	$(BIN)/python benchmarks/run.py --ratios

lint: $(VENV)/.ready-dev ## check style, format, who imports whom, and workflows
	$(BIN)/ruff check --no-cache
	$(BIN)/ruff format --check
	$(BIN)/lint-imports --no-logo
	$(BIN)/check-jsonschema --builtin-schema vendor.github-workflows .github/workflows/*.yml

types: $(VENV)/.ready-dev ## check the types
	$(BIN)/mypy

docs: $(VENV)/.ready-docs ## build the site into build/docs/, in English and Chinese
	$(BIN)/python docs/build.py build/docs

docs-links: $(VENV)/.ready-docs ## build the site, and ask the web for all addresses in it
	$(BIN)/python docs/build.py build/docs --links

wheel: $(VENV)/.ready-dev ## build the wheel into dist/
	$(BIN)/python -m build --wheel

dist: $(VENV)/.ready-dev ## build wheel and source distribution into dist/, as a release does, and check them
	$(BIN)/python -m build
	$(BIN)/python -m twine check --strict dist/*
	$(BIN)/python scripts/check_release.py --dist dist

clean: ## delete the virtual environment and all that was made
	rm -rf .venv .venv-* build dist output .pytest_cache .hypothesis .mypy_cache .ruff_cache

$(VENV)/.ready: pyproject.toml $(VENV)/.created
	$(call install,$(BIN)/python,--editable . --group test)
	@echo "Installed in $(VENV): pupper-analysis and the packages of its tests."
	@touch $@

$(VENV)/.ready-dev: $(VENV)/.ready
	$(call install,$(BIN)/python,--group dev)
	@touch $@

# With the versions of the engines that tests/data/recorded.json was computed with.
$(VENV)/.ready-ci: $(VENV)/.ready-dev
	$(call install,$(BIN)/python,--group recorded --group peers)
	@touch $@

# By pip: of the builds on several indexes, pip prefers one without CUDA.
$(VENV)/.ready-torch: $(VENV)/.ready-ci
	$(BIN)/python -m pip install --quiet --group torch
	@touch $@

$(ROBOTS)/.ready: pyproject.toml | $(VENV)/.ready
	rm -rf $(ROBOTS)
	$(call install,$(BIN)/python,--no-deps --target $(ROBOTS) --group robots)
	@touch $@

$(CONVERTERS)/.ready: pyproject.toml | $(VENV)/.ready
	$(BIN)/python -m venv --clear $(CONVERTERS)
	$(call install,$(CONVERTERS)/bin/python,--group converters)
	@touch $@

$(VENV)/.ready-benchmark: $(VENV)/.ready
	$(call install,$(BIN)/python,--group benchmark)
	@touch $@

$(VENV)/.ready-docs: $(VENV)/.ready
	$(call install,$(BIN)/python,--group docs)
	@touch $@

# Of what is not named in pyproject.toml the newest is taken: old packages warn about it.
$(LOWEST)/.ready: pyproject.toml scripts/lowest_versions.py $(VENV)/.created
	$(BIN)/python -m venv --clear $(LOWEST)
	$(BIN)/python scripts/lowest_versions.py > $(LOWEST)/constraints.txt
	$(LOWEST)/bin/python -m pip install --quiet --upgrade "pip>=25.1"
	$(LOWEST)/bin/python -m pip install --quiet --editable . --group test \
	  --constraint $(LOWEST)/constraints.txt
	@touch $@

# The first pip that knows dependency groups is 25.1.
$(VENV)/.created:
	@command -v $(PYTHON) > /dev/null || { \
	  echo "There is no $(PYTHON). Install Python 3.$(MINOR) or newer, or name one: make PYTHON=..." >&2; \
	  exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, $(MINOR)))' || { \
	  echo "$(PYTHON) is older than Python 3.$(MINOR). Name a newer one: make PYTHON=python3.12" >&2; \
	  exit 1; }
	@echo "Setting up $(VENV): this takes a minute, once."
	@$(PYTHON) -m venv --clear $(VENV) || { \
	  echo "On Debian and Ubuntu, install python3-venv first." >&2; \
	  exit 1; }
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	@touch $@
