# Sets up .venv once, then runs what is asked for. Python 3.11 or newer; another one: make PYTHON=python3.12 test
.DEFAULT_GOAL := help
.PHONY: help venv demo demo-live test lint clean
.DELETE_ON_ERROR:

PYTHON ?= $(shell for p in python3 python3.11 python3.12 python3.13; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
BIN := .venv/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
WORKERS ?= 2

help:
	@echo 'make demo    diagnose the shipped log of a leaking actuator and write its report'
	@echo 'make demo-live   watch three simulated axes on a page, one of which begins to leak'
	@echo 'make test    style, types, import rules and all tests'
	@echo 'make lint    the first three of these'
	@echo 'make venv    only set up .venv for development'
	@echo 'make clean   remove .venv and everything else that was made here'

venv: .venv/.test

demo: .venv/.demo
	@$(BIN)/fdd demo

demo-live: .venv/.test
	@$(BIN)/fdd serve --demo

test: lint
	@echo 'tests, $(WORKERS) at a time'
	@$(BIN)/pytest -n $(WORKERS)

lint: .venv/.test
	@echo 'style'
	@$(BIN)/ruff check --quiet
	@$(BIN)/ruff format --check --quiet
	@echo 'types'
	@$(BIN)/mypy --no-error-summary
	@echo 'import rules'
	@$(BIN)/lint-imports > .venv/imports.log || { cat .venv/imports.log; false; }

clean:
	rm -rf .venv build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks \
		.import_linter_cache fdd-demo-report.html
	find fdd estimators tests -name __pycache__ -type d -prune -exec rm -rf {} +

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
