# Two commands do everything on a machine with Python 3.11 or newer: `make demo` and `make test`.
# Both stay inside this folder: environment in .venv, caches and temporary files in .cache.

VENV     ?= .venv
JOBS     ?= 2
VERSIONS ?= 3.11 3.12 3.13

# Lazily the first interpreter that is new enough; `make PYTHON=/path/to/python3 ...` overrides.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { echo $$p; break; }; done)

BIN   := $(VENV)/bin
STAMP := $(VENV)/.installed

export PIP_CACHE_DIR := $(CURDIR)/.cache/pip
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export TMPDIR := $(CURDIR)/.cache/tmp
# Threads of the BLAS cost more than they give on blocks as small as ours.
export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS := 1
export MKL_NUM_THREADS := 1

.PHONY: help install demo test lint types suite partners test-pythons benchmark clean
.DEFAULT_GOAL := help

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1	/p' $(MAKEFILE_LIST) | expand -t 16

install: $(STAMP) ## create the environment and install loopcal into it, editable

$(STAMP): pyproject.toml
	@mkdir -p $(TMPDIR)
	@if [ ! -x $(BIN)/python ]; then \
		if [ -z "$(PYTHON)" ]; then \
			echo "loopcal needs Python 3.11 or newer, and none was found on PATH." >&2; \
			echo "Install one, or name it: make PYTHON=/path/to/python3 $(MAKECMDGOALS)" >&2; \
			exit 1; fi; \
		$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
			echo "$(PYTHON) cannot be used: loopcal needs Python 3.11 or newer." >&2; exit 1; }; \
		echo "creating $(VENV) with $$($(PYTHON) -V)"; \
		$(PYTHON) -m venv $(VENV); fi
	$(BIN)/python -m pip install --quiet --editable '.[test]'
	@touch $@

demo: $(STAMP) ## calibrate the examples by both methods, the truth beside them
	@$(BIN)/python examples/demo.py

test: lint types suite ## the whole suite, lint and types included

lint: $(STAMP) ## ruff: rules and format
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP) ## mypy
	$(BIN)/mypy

suite: $(STAMP) ## pytest alone
	@mkdir -p $(TMPDIR)
	$(BIN)/python -m pytest -n $(JOBS)
