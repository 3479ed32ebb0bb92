# Everything starts here; `make help` lists the targets.
PYTHON ?= python3
VENV_PYTHON := .venv/bin/python

.PHONY: help setup dev demo test lint bench clean
.DEFAULT_GOAL := help

help:  ## this list
	@sed -n 's/^\([a-z]*\):.*## /  make \1\t/p' $(MAKEFILE_LIST) | expand -t 16

setup:  ## create .venv, install the pinned requirements, build the workspace
	@$(PYTHON) launch_scripts/bootstrap.py

dev:  ## setup, and what tests and lint need
	@$(PYTHON) launch_scripts/bootstrap.py --dev

demo: setup  ## set up, then drive scenario sc1 over ROS 2 and report
	@$(VENV_PYTHON) launch_scripts/start.py --scenario sc1

test: dev  ## set up, then run all tests
	@$(VENV_PYTHON) -m pytest

lint: dev  ## set up, then check format, style and types
	@$(VENV_PYTHON) -m ruff format --check .
	@$(VENV_PYTHON) -m ruff check .
	@$(VENV_PYTHON) -m mypy

bench:  ## set up, then measure against other solvers and tools (about 5 min), into runs/bench
	@$(PYTHON) launch_scripts/bootstrap.py --bench
	@$(VENV_PYTHON) launch_scripts/bench.py

clean:  ## remove everything that make made; runs/ stays
	rm -rf .venv build install log .pytest_cache .mypy_cache .ruff_cache .hypothesis
