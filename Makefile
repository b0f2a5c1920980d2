# The workspace's commands.  `make demo` and `make test` set up whatever is missing first.
#   make PYTHON=python3.12 test    with a Python of your choice (CPython 3.11, 3.12 or 3.13)
SHELL := /usr/bin/env bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
.PHONY: help setup lint test demo record bench bench-peers prove prove-cell prove-input clean

export OPENBLAS_NUM_THREADS ?= 1
export OMP_NUM_THREADS ?= 1
JOBS ?= 2
BIN := .venv/bin
PYTEST := $(BIN)/python -m pytest
DEMO := build/demo
RECORD := build/record
STILL := src/calibration_core/test src/calibration_sim/test test
CONCEALED := test/test_concealed.py
INPUTS := test/test_fuzz.py
LIVE := src/calibration/test test/ros/test_ros_end_to_end.py test/ros/test_ros_namespaces.py test/ros/test_ros_readings.py
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
	@echo "make lint        ruff and mypy alone"
	@echo "make bench       speed and accuracy against the peer tools"
	@echo "make prove       the slow tests of the core and the simulation, and the proof on concealed effects (under 3 hours)"
	@echo "make prove-input 5,000 changed inputs, every reader and every command (under 2 hours)"
	@echo "make prove-cell  the slow tests of the live cell: faults, crashes, recovery, soak (under 2 hours)"
	@echo "make clean       remove everything that was made"

setup:
	@.ci/setup "$(python)"

lint: setup
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

# Tests of live nodes measure time: they run alone, the others share the cores.  One process takes a whole file, so
# that what its tests have in common is made once; the concealed effects are diagnosed by two processes of their own.
test: lint
	@$(PYTEST) -n $(JOBS) --dist loadfile -m "not slow" $(STILL) --ignore=test/ros --ignore=$(CONCEALED)
	@$(PYTEST) $(CONCEALED)
	@$(PYTEST) -m "not slow" $(LIVE)

prove: setup
	@$(PYTEST) -m slow $(STILL) --ignore=$(INPUTS) --ignore=test/ros
	@$(BIN)/calibration-prove --seed $(PROVE_SEED) --out build/prove/$(PROVE_SEED) --jobs $(JOBS) --batch
	@$(BIN)/calibration-prove --kinds all --seed $(PROVE_SEED) --out build/prove/$(PROVE_SEED)-second --jobs $(JOBS) --batch

prove-input: setup
	@$(PYTEST) -m slow -s $(INPUTS)

prove-cell: setup
	@$(PYTEST) -m slow src/calibration/test
	@$(PYTEST) test/ros

demo: setup
	@set +u; source install/setup.bash; exec $(BIN)/python .ci/demo.py $(DEMO)

record: setup
	@rm -rf $(RECORD)
	@$(BIN)/calibration-sim record --cell $(CELL) --out $(RECORD)/recording --seed 1
	@$(BIN)/calibration identify $(RECORD)/recording --cell $(CELL) --out $(RECORD)/identify

bench-peers: setup
	@.ci/peers "$(python)"

bench: bench-peers
	@$(PYTEST) test/bench -o python_files="bench_*.py" -s

clean:
	rm -rf .venv build install log .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find src test -name __pycache__ -prune -exec rm -rf {} +
	rm -rf src/*/*.egg-info
