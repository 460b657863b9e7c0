# Everything runs in an environment of its own, .venv/, made on first use.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Set UNIT=1 to leave out the tests that train.
MARKS := $(if $(UNIT),-m "not slow")

.PHONY: help demo test lint format clean

help: ## this list
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/'

demo: $(VENV)/.ready ## the gingerbread man from nothing to scores and pictures in out/demo
	$(BIN)/nilbs demo --out out/demo

test: $(VENV)/.ready-test lint ## lint, types and all tests, with the coverage of the two lower layers
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist loadfile $(MARKS) --cov=nilbs --cov-report=
	$(BIN)/python -m coverage report --include='nilbs/geometry/*,nilbs/io/*' --fail-under=95

lint: $(VENV)/.ready-test ## ruff and mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(VENV)/.ready-test ## put the code in the house's format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean: ## remove the environment and what programs wrote
	rm -rf $(VENV) out

$(VENV)/.ready: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "nilbs needs Python 3.11 or newer; name one with PYTHON=..."; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e .
	@touch $@

$(VENV)/.ready-test: $(VENV)/.ready
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[test]'
	@touch $@
