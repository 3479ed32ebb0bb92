# Every task of a developer; `make help` lists the targets. All but help and clean first set up .venv.
PYTHON ?= python3
VENV_PYTHON := .venv/bin/python
# Processes that run tests at the same time, a file at a time. Each has a ROS domain of its own.
# One more than two cores: a third of the time of a test of nodes is waiting.
JOBS ?= 3
PARALLEL = -n $(JOBS) --dist loadfile --no-loadscope-reorder

.PHONY: help setup dev demo test check uncompiled lint data acceptance stacks certificates faults leaderboard fuzz attack proofs mutation \
	bench lock audit clean
.DEFAULT_GOAL := help

help:  ## print this list
	@sed -n 's/^\([a-z]*\):.*## /  make \1\t/p' $(MAKEFILE_LIST) | expand -t 20

setup:  ## create .venv, install the pinned requirements, build the workspace
	@$(PYTHON) launch_scripts/bootstrap.py

dev:  ## setup, and the requirements of tests and lint
	@$(PYTHON) launch_scripts/bootstrap.py --dev

demo: setup  ## drive scenario sc1 over ROS 2 and report
	@$(VENV_PYTHON) launch_scripts/start.py --scenario sc1

test: dev  ## run all tests but those of the workshop, on JOBS processes (default 3)
	@$(VENV_PYTHON) -m pytest $(PARALLEL)

check: JOBS = 2
check: dev lint  ## lint, and the quick tests: no ROS nodes, no processes (a minute on two cores)
	@$(VENV_PYTHON) -m pytest $(PARALLEL) -m "not ros and not slow"

# Equations must give the same result without compilation. tests/markers.py lists their files.
uncompiled: dev  ## run the tests of the equations with compilation switched off
	@NUMBA_DISABLE_JIT=1 $(VENV_PYTHON) -m pytest $(PARALLEL) -m equations

lint: dev  ## check format, style and types
	@$(VENV_PYTHON) -m ruff format --check .
	@$(VENV_PYTHON) -m ruff check .
	@$(VENV_PYTHON) -m mypy

data: dev  ## write generated roads into build/roads, for cases whose recorded roads are not at hand
	@$(VENV_PYTHON) -m tests.workshop.acceptance.road_data

acceptance: data  ## drive every case of the result table, into runs/acceptance
	@$(VENV_PYTHON) -m tests.workshop.acceptance.acceptance

stacks: dev  ## drive a lane change over ROS with the messages of each stack, and with ours (25 min)
	@$(VENV_PYTHON) -m tests.workshop.acceptance.stacks --update ampc_ros/doc/stacks.md

certificates: dev  ## certify every shipped gain table anew, into the package (4 min)
	@$(VENV_PYTHON) launch_scripts/certify.py --shipped

faults: data  ## inject every kind of fault on every road, into runs/faults
	@$(VENV_PYTHON) -m tests.workshop.fault_matrix.inject

leaderboard: dev  ## drive our controllers and published ones under equal conditions, into runs/leaderboard
	@$(VENV_PYTHON) -m tests.workshop.leaderboard.leaderboard $(LEADERBOARD)

fuzz: dev  ## send a million hostile inputs each to node core, guard and gate (3 min)
	@$(VENV_PYTHON) -m tests.workshop.fuzz.fuzz

attack: dev  ## run every attack of the list in ampc_ros/doc/attacks.md, and write its counts there (10 min)
	@$(VENV_PYTHON) -m tests.workshop.attacks.attack --update ampc_ros/doc/attacks.md $(ATTACK)

# The short setting is that of continuous integration; FULL=1 takes about 10 minutes more.
proofs: dev  ## test the workshop; solve degenerate QPs; damage bags, recover; kill recorders; record drives, replay (FULL=1: more of them)
	@$(VENV_PYTHON) -m pytest $(PARALLEL) tests/workshop
	@$(VENV_PYTHON) -m tests.workshop.proofs.prove_qp --problems $(if $(FULL),100000,3000)
	@$(VENV_PYTHON) -m tests.workshop.proofs.prove_recovery --damages $(if $(FULL),3000,252)
	@$(VENV_PYTHON) -m tests.workshop.proofs.prove_recording --kills $(if $(FULL),20,2)
	@if [ -n "$(FULL)" ]; then $(VENV_PYTHON) -m tests.workshop.proofs.prove_replay; fi
	@if [ -n "$(FULL)" ]; then $(VENV_PYTHON) -m tests.workshop.proofs.prove_restarts --moments 100; fi

mutation: dev  ## change 300 details of the code, one at a time: the tests must detect 92 % (several hours)
	@$(VENV_PYTHON) -m tests.workshop.proofs.mutation $(MUTATION)

bench:  ## measure against other solvers and tools (about 10 min), into runs/bench
	@$(PYTHON) launch_scripts/bootstrap.py --bench
	@$(VENV_PYTHON) -m tests.workshop.bench.bench

# All requirements are resolved together, for Linux and every supported Python. A locked version
# stays as long as it is compatible. An installed ROS 2 needs its own numpy, so only the requirements
# of the ROS wheels contain numpy.
REQUIREMENTS := $(patsubst lock/%.in,%,$(wildcard lock/*.in))
COMPILE := .venv/bin/uv pip compile --quiet --universal --python-version=3.10 --no-header \
	--no-annotate --only-binary=:all: --no-binary=empy $(if $(UPGRADE),--upgrade)

lock: dev  ## write lock/*.txt after a change of lock/*.in; UPGRADE=1 takes newest versions
	@mkdir -p build
	@$(COMPILE) $(REQUIREMENTS:%=lock/%.in) $(if $(UPGRADE),,$(REQUIREMENTS:%=--constraints lock/%.txt)) --output-file build/pins.txt
	@for name in $(REQUIREMENTS); do case $$name in *ros) numpy=;; *) numpy="--no-emit-package numpy";; esac; \
	$(COMPILE) lock/$$name.in --constraints build/pins.txt --generate-hashes --no-strip-extras $$numpy --output-file lock/$$name.txt; done

audit: dev  ## look up every package of lock/ in the public database of vulnerabilities
	@for file in lock/*.txt; do $(VENV_PYTHON) -m pip_audit --disable-pip --require-hashes --timeout=15 -r $$file || exit; done

clean:  ## remove all that make has created, except runs/
	rm -rf .venv build install log .pytest_cache .mypy_cache .ruff_cache .hypothesis
