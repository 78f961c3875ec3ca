# SPDX-License-Identifier: Apache-2.0
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SETUP := $(VENV)/.setup
DEV := $(VENV)/.dev
SOURCES := src tests benchmarks docs qgis

.DEFAULT_GOAL := help
.PHONY: help setup dev demo test check docs gallery qgis wheel format clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  make %-8s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: $(SETUP) ## make .venv with the skymoor command: what users need

dev: $(DEV) ## the same with all extras, the tools of the checks and what the tests need

$(SETUP): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "skymoor needs Python 3.11 or newer, and $(PYTHON) is older or missing: make setup PYTHON=python3.12" >&2; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || { \
	  echo "python could not make $(VENV): install its venv module (Debian: apt-get install python3-venv)" >&2; exit 1; }
	$(BIN)/python -m pip install --quiet --constraint requirements.lock setuptools
	$(BIN)/python -m pip install --quiet --constraint requirements.lock --no-build-isolation -e .
	@touch $@

$(DEV): $(SETUP)
	$(BIN)/python -m pip install --quiet -r requirements.lock
	@# It declares training tools and a torchvision that exists for CUDA only; what it imports is in the lock.
	$(BIN)/python -m pip install --quiet --no-deps romatch==0.1.2
	@touch $@

demo: $(SETUP) ## simulate a small site, register it, compare with the truth
	$(BIN)/skymoor demo --out skymoor-demo

test: $(DEV) ## run the tests
	$(BIN)/python -m pytest -n 2

check: $(DEV) ## what CI runs: format, lint, types, import contracts, documentation, tests
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(MAKE) --no-print-directory docs
	$(BIN)/python -m pytest -n 2

wheel: $(SETUP) ## build the wheel, install it where nothing else is, and run the demo from there
	rm -rf build dist
	$(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist .
	$(PYTHON) -m venv build/empty
	@# With the versions of the checks, as make setup.
	build/empty/bin/python -m pip install --quiet --constraint requirements.lock dist/skymoor-*.whl
	cd build && empty/bin/python -c 'import skymoor; assert "empty" in skymoor.__file__, skymoor.__file__'
	build/empty/bin/skymoor doctor
	build/empty/bin/skymoor demo --out build/demo --quiet

docs: $(DEV) ## build the documentation into site/; needs no network
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

RUN ?= skymoor-demo/result

skymoor-demo/result/summary.json:
	$(MAKE) --no-print-directory demo

gallery: $(DEV) $(RUN)/summary.json ## make the pictures of the documentation from RUN=DIR, by default the demo
	PYTHONPATH=docs $(BIN)/python -m gallery $(RUN)

qgis: ## zip the QGIS plugin into dist/skymoor_qgis.zip
	rm -rf build/qgis dist/skymoor_qgis.zip
	mkdir -p build/qgis dist
	cp -r qgis/skymoor_qgis build/qgis/
	rm -rf build/qgis/skymoor_qgis/__pycache__
	cp LICENSE build/qgis/skymoor_qgis/
	cd build/qgis && $(PYTHON) -m zipfile -c ../../dist/skymoor_qgis.zip skymoor_qgis

format: $(DEV) ## format the sources
	$(BIN)/ruff format $(SOURCES)
	$(BIN)/ruff check --fix $(SOURCES)

clean: ## remove caches and .venv
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis build site src/*.egg-info
	find src tests qgis -name __pycache__ -type d -prune -exec rm -rf {} +
