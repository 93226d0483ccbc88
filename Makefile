# Sets up .venv once, then runs what is asked for. Python 3.11 or newer; another one: make PYTHON=python3.12 test
.DEFAULT_GOAL := help
.PHONY: help venv docs demo demo-live evidence test test-all lint style types imports checked compile-plant compile-diagnosis \
	compile-filters clean
.DELETE_ON_ERROR:

PYTHON ?= $(shell for p in python3 python3.11 python3.12 python3.13; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
BIN := .venv/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
WORKERS ?= 2

help:
	@echo 'make demo    diagnose the shipped log of a leaking actuator and write its report'
	@echo 'make demo-live   watch three simulated axes on a page, one of which begins to leak'
	@echo 'make test    style, types, import rules and the fast tests'
	@echo 'make test-all   the same with all tests'
	@echo 'make evidence   measure anew what the committed reports say (an hour and a half)'
	@echo 'make lint    the first three of these'
	@echo 'make venv    only set up .venv for development'
	@echo 'make docs    build the documentation into site/'
	@echo 'make clean   remove .venv and everything else that was made here'

venv: .venv/.test

demo: .venv/.demo
	@$(BIN)/fdd demo

demo-live: .venv/.test
	@$(BIN)/fdd serve --demo

# Workers keep to neighbouring tests, which share what they simulate, until one has none left.
PYTEST := $(BIN)/pytest -n $(WORKERS) --dist worksteal

test: checked
	@echo 'fast tests, $(WORKERS) at a time'
	@$(PYTEST) -m 'not slow'

test-all: checked
	@echo 'all tests, $(WORKERS) at a time'
	@$(PYTEST)

# What takes one core each, side by side; make lint has three of them.
checked: .venv/.test
	@echo 'style, types and import rules; compiling'
	@$(MAKE) --no-print-directory -j $(WORKERS) types compile-diagnosis compile-filters compile-plant style imports

# Measurements of speed come first, while nothing else runs.
evidence: .venv/.test
	@for each in load plant estimators thesis soak troubles; do $(BIN)/python -m reports $$each || exit 1; done

lint: style types imports

docs: .venv/.test
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict
	@echo 'site/index.html'

style: .venv/.test
	@$(BIN)/ruff check --quiet
	@$(BIN)/ruff format --check --quiet

types: .venv/.test
	@$(BIN)/mypy --no-error-summary

imports: .venv/.test
	@$(BIN)/lint-imports > .venv/imports.log || { cat .venv/imports.log; false; }

compile-plant compile-diagnosis compile-filters: compile-%: .venv/.test
	@$(BIN)/python -m tests.compiling $*

clean:
	rm -rf .venv build dist site *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks \
		.import_linter_cache fdd-demo-report.html
	find fdd estimators reports tests -name __pycache__ -type d -prune -exec rm -rf {} +

$(BIN)/python:
	@test -n '$(PYTHON)' || { echo 'no Python 3.11 or newer found; name one: make PYTHON=/path/to/python3 ...' >&2; false; }
	@echo 'creating .venv with $(PYTHON)'
	@$(PYTHON) -m venv .venv

# The product alone, for the demo; then what the tests need besides.
.venv/.demo: pyproject.toml constraints.txt | $(BIN)/python
	@echo 'installing fdd into .venv (a minute or two, once)'
	@$(PIP) -e .
	@touch $@

.venv/.test: pyproject.toml constraints.txt | $(BIN)/python
	@echo 'installing fdd and its test tools into .venv (a minute or two, once)'
	@$(PIP) -e '.[test]'
	@touch .venv/.demo $@
