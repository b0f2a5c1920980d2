# The workspace's commands.  `make demo` and `make test` set up whatever is missing first.
#   make PYTHON=python3.12 test    with a Python of your choice (CPython 3.11, 3.12 or 3.13)
SHELL := /usr/bin/env bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
.PHONY: help packages setup lint test demo record docs bench bench-peers prove prove-fleet setup-fleet prove-cell prove-input prove-use prove-pairs clean

export OPENBLAS_NUM_THREADS ?= 1
export OMP_NUM_THREADS ?= 1
# Hundreds of processes start: without bytecode on the disk each of them would compile everything anew.
unexport PYTHONDONTWRITEBYTECODE
JOBS ?= $(shell nproc)
SHARING = $(shell expr $(JOBS) + 1)
BY_FILE := --dist loadfile --no-loadscope-reorder
BIN := .venv/bin
PYTEST := $(BIN)/python -m pytest
DEMO := build/demo
RECORD := build/record
RESULTS := build/test
STILL := test src/calibration_sim/test src/calibration_core/test
INPUTS := test/test_fuzz.py test/test_absurd_inputs.py test/test_bias.py
FLEET := test/test_fleet_proof.py test/test_fleet_speed.py
USE := test/test_use.py test/test_real_use.py test/test_ageing.py
PAIRS := test/test_pairs.py
NODES := src/calibration/test
ALONE = $(shell grep -l mark.alone $(NODES)/*.py)
WHOLE := test/ros/test_ros_end_to_end.py test/ros/test_ros_kills.py test/ros/test_ros_namespaces.py test/ros/test_ros_readings.py
# Published; for development other seeds were used.
PROVE_SEED ?= 20261
CELL := config/cells/demo.cell.yaml

# "ok PYTHON", or the sentence that says what the machine lacks.
found = $(eval found := $$(shell .ci/prerequisites "$(PYTHON)"))$(found)
python = $(if $(filter ok,$(firstword $(found))),$(wordlist 2,99,$(found)),$(error $(found)))

help:
	@echo "make demo        the whole suite on a simulated cell: measured, identified live and offline, diagnosed"
	@echo "make record      without nodes: simulate a loaded recording, identify it, name the report"
	@echo "make test        lint, types and all tests"
	@echo "make setup       virtual environment, packages, messages"
	@echo "make setup-fleet the packages of calibration fleet besides: Dask and Parquet (170 MB)"
	@echo "make lint        ruff and mypy alone"
	@echo "make docs        the documentation as a site, build/docs/site"
	@echo "make bench       speed and accuracy against the peer tools"
	@echo "make prove       the slow tests of the core and the simulation, and the proof on concealed effects (under 3 hours)"
	@echo "make prove-input 5,000 changed inputs, absurd inputs, 2,000 good ones, coverage of Table 2 (under 2 hours)"
	@echo "make prove-use   50 calibrated robots drill and mill under load (under half an hour)"
	@echo "make prove-pairs 356 pairs of a simulation and a recording of another plant (two hours on an idle core)"
	@echo "make prove-fleet a simulated plant of 600 robots: damages found, speed, memory, kills (under 2 hours)"
	@echo "make prove-cell  the slow tests of the live cell: faults, crashes, recovery, soak (some 4 hours on four cores)"
	@echo "make prove-panel the operator's page in a real browser: sizes, faults, load, stop (under 20 minutes on four idle cores)"
	@echo "make clean       remove everything that was made"

packages:
	@.ci/setup "$(python)" packages

setup: packages
	@.ci/setup "$(python)" workspace

lint: packages
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

# A test that runs a whole cell runs alone; the others share the cores, one process more than there are, for some wait
# more than they compute.  One process takes a whole file, so that what its tests have in common is made once.  Files are
# taken in the order given here (by itself xdist takes those of the fewest tests, which are the longest, last), the longest
# among the first, so that no core waits for the last.  The last line says what was skipped, and why.
# Drawn inputs are the same in every run (one tree, one answer); `make prove` draws them anew.
# Lint and types need the packages alone: they are checked while the messages are built.
test: PYTEST += --hypothesis-seed=0 --junit-xml
test: packages
	@$(MAKE) --no-print-directory -j3 lint setup setup-fleet
	@rm -rf $(RESULTS)
	@$(PYTEST) $(RESULTS)/core.xml -n $(SHARING) $(BY_FILE) -m "not slow" $(STILL) --ignore=test/ros
	@$(PYTEST) $(RESULTS)/nodes.xml -n $(SHARING) $(BY_FILE) -m "not slow and not alone" $(NODES)
	@$(PYTEST) $(RESULTS)/alone.xml -m "alone and not slow" $(ALONE)
	@$(PYTEST) $(RESULTS)/whole.xml -m "not slow" $(WHOLE)
	@.ci/not_looked_at $(RESULTS)/*.xml

prove: setup setup-fleet
	@$(PYTEST) -n $(JOBS) -m "hypothesis and not slow" $(STILL) $(NODES)
	@$(PYTEST) -m slow $(STILL) $(INPUTS:%=--ignore=%) $(USE:%=--ignore=%) $(FLEET:%=--ignore=%) --ignore=$(PAIRS) --ignore=test/ros
	@$(BIN)/calibration-prove --seed $(PROVE_SEED) --out build/prove/$(PROVE_SEED) --jobs $(JOBS) --batch
	@$(BIN)/calibration-prove --kinds all --seed $(PROVE_SEED) --out build/prove/$(PROVE_SEED)-second --jobs $(JOBS) --batch

prove-input: setup
	@$(PYTEST) -m slow -s $(INPUTS)

prove-pairs: setup
	@$(PYTEST) -s -m slow $(PAIRS)

prove-use: setup
	@$(PYTEST) -m slow -s $(USE)
	@$(PYTEST) -s test/ros/test_ros_compensation.py

# FLEET_ROBOTS=60 for a plant of 60 robots instead of 600.
prove-fleet: setup setup-fleet
	@$(PYTEST) -m slow -s $(FLEET)

# A whole cell wants two cores for itself: on four cores two of them run, on two one.
CELLS := $(shell expr $(JOBS) / 2 \| 1)
prove-cell: PYTEST += -n $(CELLS) --dist loadfile
prove-cell: setup
	@$(PYTEST) -m slow src/calibration/test $(PANEL:%=--ignore=%)
	@$(PYTEST) test/ros

demo: setup
	@set +u; source install/setup.bash; exec $(BIN)/python .ci/demo.py $(DEMO)

record: setup
	@rm -rf $(RECORD)
	@$(BIN)/calibration-sim record --cell $(CELL) --out $(RECORD)/recording --seed 1
	@$(BIN)/calibration identify $(RECORD)/recording --cell $(CELL) --out $(RECORD)/identify

# Dask and Parquet, of which no other command needs anything.
setup-fleet: packages
	@.ci/fleet

docs: setup
	@.ci/docs "$(python)"

bench-peers: setup
	@.ci/peers "$(python)"

bench: bench-peers
	@$(PYTEST) test/bench -o python_files="bench_*.py" -s

clean:
	rm -rf .venv build install log .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find src test -name __pycache__ -prune -exec rm -rf {} +
	rm -rf src/*/*.egg-info

# The operator's page in a real browser: a measurement at two sizes, faults, load, stop, clicks, accessibility (under 20 minutes).
.PHONY: prove-panel
PANEL := $(addprefix src/calibration/test/test_panel_,browser.py faults.py load.py)
prove-panel: setup
	@$(PYTEST) -m slow -s $(PANEL)
