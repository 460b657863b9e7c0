# Everything runs in an environment of its own, .venv/, made on first use.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := -m pip install --quiet --disable-pip-version-check -c constraints.txt
COMMA := ,
# Set UNIT=1 to leave out the tests that train.
MARKS := $(if $(UNIT),-m "not slow")
# Blender's Python package is large, so that one environment serves all checkouts.
BPY := 5.0.1
BLENDER ?= $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/nilbs/bpy-$(BPY)

# The model that `make bench` times.
BENCH := out/bench/$(if $(NILBS_DATA),elephant,gingerbread).nilbs

.PHONY: help demo test test-gpu test-browser lint docs format study bench blender bpy notebook wheel clean

help: ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/'

demo: $(VENV)/.ready ## the gingerbread man from nothing to scores and pictures in out/demo
	$(BIN)/nilbs demo --out out/demo

test: lint ## lint, types and all tests; geometry and io must be covered (UNIT=1: without the tests that train)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist worksteal --durations 25 $(MARKS) --cov --cov-report=term:skip-covered

test-gpu: $(VENV)/.ready-test ## the search on a GPU, or where there is none its code interpreted; installs Triton (200 MB, Linux)
	$(BIN)/python $(PIP) triton
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest tests/fields/test_gpu_search.py tests/race/test_contestants.py

test-browser: $(VENV)/.ready-test ## the page of nilbs view in Chromium without a screen; needs chromium and chromium-driver
	$(BIN)/python $(PIP) selenium
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest tests/viewer/test_browser.py

lint: $(VENV)/.ready-test ## ruff and mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: $(VENV)/.ready-docs ## the documentation in out/docs; a warning is an error
	OMP_NUM_THREADS=1 $(BIN)/python -m sphinx -W --keep-going -q docs out/docs
	@echo out/docs/index.html

format: $(VENV)/.ready-test ## put the code in the house's format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

study: $(VENV)/.ready ## train and score every method, in days or with ARGS=--quick in minutes: make study OUT=../study
	@test -n "$(OUT)" || { echo "name the folder of the results, outside this one: make study OUT=../study"; exit 2; }
	$(BIN)/python -m benchmarks.study --out $(OUT) $(ARGS)

bench: $(VENV)/.ready-bench $(BENCH) ## time nilbs beside libraries that query the posed mesh, in out/bench (ARGS=--quick: minutes)
	$(BIN)/nilbs benchmark $(BENCH) -o out/bench $(ARGS)

# The elephant of the real meshes if NILBS_DATA names their folder, else the gingerbread man.
out/bench/elephant.nilbs: | $(VENV)/.ready-bench
	mkdir -p $(@D)
	$(BIN)/nilbs train $(NILBS_DATA)/elephant/elephant.obj $(NILBS_DATA)/elephant/elephant.tgf \
	  $(NILBS_DATA)/elephant/elephant-weights.dmat --motion $(NILBS_DATA)/elephant/elephant-anim.dmat -o $@

out/bench/gingerbread.nilbs: | $(VENV)/.ready-bench
	mkdir -p $(@D)
	$(BIN)/nilbs train examples/assets/cookie.obj examples/assets/gingerbread.tgf -o $@

blender: bpy $(VENV)/.ready-test ## compare with Blender, and run the example for it; its package bpy is installed in $XDG_CACHE_HOME/nilbs on first use
	OMP_NUM_THREADS=1 NILBS_BPY=$(BLENDER)/bin/python $(BIN)/python -m pytest tests/io/test_blender.py tests/examples/test_blender_script.py

bpy:
	test -x $(BLENDER)/bin/python || $(PYTHON) -m venv $(BLENDER)
	$(BLENDER)/bin/python -m pip install --quiet --disable-pip-version-check bpy==$(BPY)
	$(BLENDER)/bin/python -c "import bpy"

notebook: $(VENV)/.ready-notebook ## run examples/notebook in a fresh kernel; its results are in out/gingerbread.ipynb
	$(BIN)/python examples/notebook/run.py

wheel: $(VENV)/.ready-test ## build the wheel and the sdist in out/dist, and use the wheel in a bare environment, without torch
	rm -rf out/dist out/bare
	$(BIN)/python -m build --outdir out/dist
	$(PYTHON) -m venv out/bare
	out/bare/bin/python $(PIP) out/dist/*.whl
	cd out && bare/bin/python ../tests/check_wheel.py dist

clean: ## remove the environment and what programs wrote
	rm -rf $(VENV) out

# An environment: .ready for programs; others with what the tests, the documentation, the benchmark or the notebook need too.
$(VENV)/.ready $(VENV)/.ready-test $(VENV)/.ready-docs $(VENV)/.ready-bench $(VENV)/.ready-notebook: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "nilbs needs Python 3.11 or newer; name one with PYTHON=..."; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python $(PIP) -e '.[torch,view$(patsubst .ready-%,$(COMMA)%,$(filter .ready-%,$(notdir $@)))]'
	@touch $@
