# Everything starts here; `make help` lists the targets.
PYTHON ?= python3
VENV_PYTHON := .venv/bin/python

.PHONY: help setup dev demo test uncompiled lint acceptance faults mutation fuzz proofs bench lock audit clean
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
	@NUMBA_DISABLE_JIT=1 $(VENV_PYTHON) -m pytest $(wildcard $(UNCOMPILED:%=tests/*/test_%.py)) -k "$(UNCOMPILED_BUT)"

lint: dev  ## set up, then check format, style and types
	@$(VENV_PYTHON) -m ruff format --check .
	@$(VENV_PYTHON) -m ruff check .
	@$(VENV_PYTHON) -m mypy

acceptance: dev  ## set up, then drive every case of the result table, into runs/acceptance
	@$(VENV_PYTHON) -m tests.workshop.acceptance.acceptance

faults: dev  ## set up, then let every fault happen on every road, into runs/faults
	@$(VENV_PYTHON) -m tests.workshop.fault_matrix.inject

mutation: dev  ## set up, then change guard and filter in every small way: a test has to notice
	@$(VENV_PYTHON) -m pip install --quiet -r lock/requirements-mutation.txt
	@$(VENV_PYTHON) -m tests.workshop.proofs.mutation

fuzz: dev  ## set up, then throw a million hostile inputs each at node core and guard (2 min)
	@$(VENV_PYTHON) -m tests.workshop.fuzz.fuzz

proofs: dev  ## set up, then run the tests of the workshop, record, kill, recover and replay
	@$(VENV_PYTHON) -m pytest tests/workshop
	@$(VENV_PYTHON) -m tests.workshop.proofs.prove_recording
	@$(VENV_PYTHON) -m tests.workshop.proofs.prove_replay

bench:  ## set up, then measure against other solvers and tools (about 10 min), into runs/bench
	@$(PYTHON) launch_scripts/bootstrap.py --bench
	@$(VENV_PYTHON) -m tests.workshop.bench.bench

# All requirements are resolved together, for Linux and every Python that this project serves.
# A version that is locked already stays as long as it fits. Where ROS 2 is installed, its messages
# need its own numpy: only the ROS wheels bring one.
REQUIREMENTS := $(patsubst lock/%.in,%,$(wildcard lock/*.in))
COMPILE := .venv/bin/uv pip compile --quiet --universal --python-version=3.10 --no-header \
	--no-annotate --only-binary=:all: --no-binary=empy $(if $(UPGRADE),--upgrade)

lock: dev  ## set up, then write lock/*.txt after a change of lock/*.in; UPGRADE=1 takes newest versions
	@mkdir -p build
	@$(COMPILE) $(REQUIREMENTS:%=lock/%.in) $(if $(UPGRADE),,$(REQUIREMENTS:%=--constraints lock/%.txt)) --output-file build/pins.txt
	@for name in $(REQUIREMENTS); do case $$name in *ros) numpy=;; *) numpy="--no-emit-package numpy";; esac; \
	$(COMPILE) lock/$$name.in --constraints build/pins.txt --generate-hashes --no-strip-extras $$numpy --output-file lock/$$name.txt; done

audit: dev  ## set up, then ask the public database of vulnerabilities about every package in lock/
	@for file in lock/*.txt; do $(VENV_PYTHON) -m pip_audit --disable-pip --require-hashes --timeout=15 -r $$file || exit; done

clean:  ## remove everything that make made; runs/ stays
	rm -rf .venv build install log .pytest_cache .mypy_cache .ruff_cache .hypothesis
