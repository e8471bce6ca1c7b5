# `make` makes an environment; `make help` lists the targets. Every target makes its own when there is none.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
JOBS ?= 2

.DEFAULT_GOAL := install
.PHONY: help install report reproduce test evidence test-matrix test-page lint bench calibrate coverage reports notebooks docs clean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

install: $(STAMP)  ## make .venv with percept, and say how to activate it (also just `make`)
	@echo 'percept is installed in $(VENV). Activate it: source $(BIN)/activate'

$(STAMP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "percept needs Python 3.11 or later; set PYTHON=python3.x")'
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --editable '.[test,lint]'
	@touch $@

report: $(STAMP)  ## analyse the published study and print the page's path
	@$(BIN)/percept report datasets/hbfd_sessions.csv --scene datasets/hbfd.toml --out build/hbfd --seed 1

test: lint  ## lint, types and the whole test suite
	@$(BIN)/python -m compileall -q percept reports tests  # Many tests start percept: each would compile it again
	@$(BIN)/python -m pytest -n $(JOBS) --dist loadfile -q

evidence: $(STAMP)  ## tests that take minutes: refits, kills, sweeps; their page in reports/evidence
	@$(BIN)/python -m tests.evidence --workers $(JOBS) --out reports/evidence
	@$(BIN)/python -m reports loop --out reports/evidence

test-page: $(STAMP) build/node_modules/axe-core  ## the report's page in a headless Chromium
	@$(BIN)/python -m pip install --quiet --editable '.[page]'
	@$(BIN)/python -m pytest -m page tests/page -q -rs

build/node_modules/axe-core:
	@npm install --silent --no-save --prefix build axe-core || echo "no axe-core: accessibility is not tested"

test-matrix:  ## the tests on Python 3.11 and 3.13, and on 3.11 with the oldest declared dependencies
	@$(MAKE) --no-print-directory matrix-leg LEG=3.11
	@$(MAKE) --no-print-directory matrix-leg LEG=3.13
	@$(MAKE) --no-print-directory matrix-leg LEG=oldest OF=3.11

# One environment and one run of the tests. Old packages meet newer ones of others and deprecate each other:
# with the oldest versions such warnings are shown and not errors.
OF = $(LEG)
LEG_BIN = build/matrix/$(LEG)/bin
.PHONY: matrix-leg
matrix-leg:
	@if ! command -v python$(OF) >/dev/null || ! python$(OF) -c '' 2>/dev/null; then \
	    echo "test-matrix: no python$(OF) on PATH; leg $(LEG) is left out"; exit 0; \
	fi; set -e; \
	test -x $(LEG_BIN)/python || python$(OF) -m venv build/matrix/$(LEG); \
	: > build/matrix/$(LEG).txt; \
	if test $(LEG) = oldest; then \
	    $(LEG_BIN)/python -m tests.oldest pyproject.toml > build/matrix/$(LEG).txt; \
	fi; \
	$(LEG_BIN)/python -m pip install --quiet --constraint build/matrix/$(LEG).txt --editable '.[test,tables]'; \
	echo "test-matrix: $(LEG)"; \
	$(LEG_BIN)/python -m pytest -n $(JOBS) --dist loadfile -q \
	    $(if $(filter oldest,$(LEG)),-W default::DeprecationWarning)

lint: $(STAMP)  ## ruff (with docstring rules) and strict types
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy --num-workers $(JOBS)

reproduce: $(STAMP)  ## the paper claim by claim, and print the page's path
	@$(BIN)/python -m reports hbfd --out build/reproduction

# Pages name the commit they are made from: make them in a clean tree, and commit them alone.
reports: reproduced digits bench coverage calibrate evidence  ## every page of reports/ (hours; each target alone resumes)

.PHONY: reproduced digits
reproduced: $(STAMP)  ## the example page and the paper of reports/ (minutes)
	@$(MAKE) --no-print-directory report
	@cp build/hbfd/report.html reports/example/report.html
	@$(BIN)/python -m reports hbfd --out reports/hbfd
	@$(BIN)/python -m pip install --quiet --editable '.[page]'
	@$(BIN)/python -m tests.page.screenshots

digits: $(STAMP)  ## digits kept, and what whole commands cost and skip, in reports/benchmark (half an hour)
	@$(BIN)/python -m reports digits --out reports/benchmark
	@$(BIN)/python -m reports commands --out reports/benchmark
	@$(BIN)/python -m reports scale --out reports/benchmark

bench: $(STAMP)  ## run time against error next to other samplers, and fits of many designs (two hours; extra peers)
	@$(BIN)/python -m reports samplers --out reports/benchmark
	@$(BIN)/python -m reports designs --out reports/benchmark

coverage: $(STAMP)  ## real coverage of every interval in reports/coverage (hours); it resumes
	@$(BIN)/percept calibrate datasets/hbfd_sessions.csv --scene datasets/hbfd.toml --subjects 10 3 30 \
	    --truth lognormal normal --studies 300 --classical 1000 --workers $(JOBS) --out reports/coverage --quiet
	@$(BIN)/python -m reports verdicts --out reports/coverage/verdicts
	@$(BIN)/python -m reports equivalence --out reports/equivalence

calibrate: $(STAMP)  ## simulation-based calibration, 300 fits of each design (hours); it resumes
	@$(BIN)/python -m reports sbc --workers $(JOBS) --out reports/calibration

notebooks: $(STAMP)  ## run the notebooks of docs and keep what they show
	@$(BIN)/python -m pip install --quiet --editable '.[docs]'
	@$(BIN)/jupyter execute --inplace docs/notebooks/*.ipynb

docs: $(STAMP)  ## the documentation as a site in build/docs
	@$(BIN)/python -m pip install --quiet --editable '.[docs]'
	@$(BIN)/python -m sphinx -W --keep-going -q -b html docs build/docs
	@echo build/docs/index.html

clean:  ## remove the environment and everything built
	rm -rf $(VENV) build dist .mypy_cache .ruff_cache .hypothesis
