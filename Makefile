# make train sets everything up and runs the main job; make test sets up and passes the tests.

VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
SITE := $(VENV)/.site
PYTHON ?= $(firstword $(shell command -v python3.11 python3.12 python3.13 python3))
TORCH := $(shell sed -n 's/^torch==/torch==/p' constraints.txt)
PACKAGES := env agent storage repeatable lockstep conf training server_app client_app experiments risfleet
WORKERS ?= auto
PARALLEL := -n $(WORKERS) --maxprocesses 8 --dist loadfile --no-loadscope-reorder
CHAOS_KILLS ?= 50
CHAOS_SEED ?= 0
SOURCES := $(PACKAGES) tests benchmarks tools docs/examples

.PHONY: setup train test test-all chaos bench docs lint lint-format lint-rules lint-types clean

setup: $(READY)

# torch goes first and by itself, so that no other package's range can pull in a larger build.
$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check $(TORCH)
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

train: $(READY)
	$(BIN)/risfleet train $(ARGS)

# The parts are what .pre-commit-config.yaml runs.
lint: lint-format lint-rules lint-types

lint-format: $(READY)
	$(BIN)/ruff format --check $(SOURCES)

lint-rules: $(READY)
	$(BIN)/ruff check $(SOURCES)

lint-types: $(READY)
	$(BIN)/mypy

# A worker for each core; the tests of a file share its fixtures, so they stay on one. Files go in
# the order of folders: by numbers of tests the few long ones would come last.
test: lint
	$(BIN)/pytest $(PARALLEL) --cov -m "not slow and not chaos"

test-all: export HYPOTHESIS_PROFILE := thorough
test-all: lint
	$(BIN)/pytest $(PARALLEL) --cov -m "not chaos"

# Processes of real runs are killed at random moments; two hosts lose each other (as root, on Linux).
chaos: $(READY)
	$(BIN)/pytest -m chaos tests/tools
	$(BIN)/python -m tools.chaos --kills $(CHAOS_KILLS) --seed $(CHAOS_SEED)

bench: $(READY)
	$(BIN)/python -m benchmarks

# The documents as a site, in site/.
$(SITE): $(READY)
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	touch $@

docs: $(SITE)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

clean:
	rm -rf $(VENV) site .mypy_cache .ruff_cache .pytest_cache .hypothesis *.egg-info
