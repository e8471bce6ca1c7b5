# `make help` lists the targets. Every target makes its own environment when there is none.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
JOBS ?= 2

.DEFAULT_GOAL := help
.PHONY: help report reproduce test test-page lint bench calibrate docs clean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

$(STAMP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "percept needs Python 3.11 or later; set PYTHON=python3.x")'
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --editable '.[test,lint]'
	@touch $@

report: $(STAMP)  ## analyse the published study and print the page's path
	@$(BIN)/percept report datasets/hbfd_sessions.csv --scene datasets/hbfd.toml --out build/hbfd --seed 1

test: lint  ## lint, types and the whole test suite
	@$(BIN)/python -m pytest -n $(JOBS) --dist loadfile -q

test-page: $(STAMP) build/node_modules/axe-core  ## the report's page in a headless Chromium
	@$(BIN)/python -m pytest -m page tests/page -q -rs

build/node_modules/axe-core:
	@npm install --silent --no-save --prefix build axe-core || echo "no axe-core: accessibility is not tested"

lint: $(STAMP)  ## ruff (with docstring rules) and strict types
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

bench: $(STAMP)  ## run time against error, on this machine
	@$(BIN)/percept bench

reproduce: $(STAMP)  ## the paper claim by claim, and print the page's path
	@$(BIN)/percept reproduce --out build/reproduction

calibrate: $(STAMP)  ## simulation-based calibration, 1000 fits of each design (hours); it can be taken up again
	@$(BIN)/percept sbc --fits 1000 --workers $(JOBS) --out build/calibration

docs: $(STAMP)  ## the API's pages, from docstrings, in build/docs
	@$(BIN)/python -m pip install --quiet --editable '.[docs]'
	@$(BIN)/python docs/build.py build/docs

clean:  ## remove the environment and everything built
	rm -rf $(VENV) build dist .mypy_cache .ruff_cache .hypothesis
