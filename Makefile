# Everything starts here; `make help` lists the targets.
PYTHON ?= python3
VENV_PYTHON := .venv/bin/python

.PHONY: help setup dev demo test uncompiled lint mutation fuzz bench lock audit clean
.DEFAULT_GOAL := help

help:  ## this list
	@sed -n 's/^\([a-z]*\):.*## /  make \1\t/p' $(MAKEFILE_LIST) | expand -t 20

setup:  ## create .venv, install the pinned requirements, build the workspace
	@$(PYTHON) launch_scripts/bootstrap.py

dev:  ## setup, and what tests and lint need
	@$(PYTHON) launch_scripts/bootstrap.py --dev

demo: setup  ## set up, then drive scenario sc1 over ROS 2 and report
	@$(VENV_PYTHON) launch_scripts/start.py --scenario sc1

test: dev  ## set up, then run all tests
	@$(VENV_PYTHON) -m pytest

# Without compilation the equations must give the same. Closed loops would take minutes, and so
# would 2000 sweeps of Hildreth on hundreds of problems; ROS nodes have nothing of their own to say.
UNCOMPILED := actuator car constraints gain_table interpolation laguerre lateral_mpc metrics model \
	pacejka path prediction preview_model progress pure_pursuit qp scenario types
UNCOMPILED_BUT := not 2000 and not enough_sweeps

uncompiled: dev  ## set up, then run the tests of the equations with compilation switched off
	@NUMBA_DISABLE_JIT=1 $(VENV_PYTHON) -m pytest $(UNCOMPILED:%=tests/test_%.py) -k "$(UNCOMPILED_BUT)"

lint: dev  ## set up, then check format, style and types
	@$(VENV_PYTHON) -m ruff format --check .
	@$(VENV_PYTHON) -m ruff check .
	@$(VENV_PYTHON) -m mypy

mutation: dev  ## set up, then change guard and filter in every small way: a test has to notice
	@$(VENV_PYTHON) -m pip install --quiet -r lock/requirements-mutation.txt
	@$(VENV_PYTHON) launch_scripts/mutation.py

fuzz: dev  ## set up, then throw a million hostile inputs each at node core and guard (2 min)
	@$(VENV_PYTHON) launch_scripts/fuzz.py

bench:  ## set up, then measure against other solvers and tools (about 10 min), into runs/bench
	@$(PYTHON) launch_scripts/bootstrap.py --bench
	@$(VENV_PYTHON) launch_scripts/bench.py

lock: dev  ## set up, then write lock/ after a change of requirements*.txt; UPGRADE=1 takes newest versions
	@$(VENV_PYTHON) -m launch_scripts.lock $(if $(UPGRADE),--upgrade)

audit: dev  ## set up, then ask the public database of vulnerabilities about every package in lock/
	@$(VENV_PYTHON) -m launch_scripts.audit

clean:  ## remove everything that make made; runs/ stays
	rm -rf .venv build install log .pytest_cache .mypy_cache .ruff_cache .hypothesis
