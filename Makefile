# `make` lists the targets. All of them work in a fresh clone: what they need is installed into .venv first.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
RUN    := $(VENV)/.run-installed
DEV    := $(VENV)/.dev-installed
DOCS   := $(VENV)/.docs-installed
RUNS   ?= runs
BENCH  ?= bench.json
STUDY  := paper-study paper-study-near paper-study-sizes table1-nearest
OLD    ?= bench.json
NEW    ?= bench.json

# Shapes and dtypes are checked at every call, in the packages that compute. It takes as long again.
SHAPE_CHECKS := --jaxtyping-packages=meshfit.mesh,meshfit.images,meshfit.subdivision,meshfit.analysis,meshfit.remeshing,meshfit.loss,meshfit.fitting,meshfit.measuring,beartype.beartype

ALL_TARGETS := --set 'targets=[bunny, cow, bone, airplane, mousehead]' --set 'seeds=[0, 1, 2]'

.DEFAULT_GOAL := help
.PHONY: help setup quickstart test shapes check lint types layers docs table1 table1-nearest study reproduce bench bench-compare ablation accuracy targets-bench images-bench registration-bench kinds kills figures zoo mousehead wheel clean

help:  ## List the targets
	@awk -F ':.*## ' '/^[a-z0-9-]+:.*## / {printf "  make %-14s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(DEV)  ## Make .venv and install meshfit into it, with what its tests need

# torch first and by its exact version: a range would let pip take a build with CUDA, which is gigabytes larger.
$(RUN): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "meshfit needs Python 3.11 or newer; found $$($(PYTHON) --version). Set PYTHON=..."; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet "$$(grep '^torch==' constraints.txt)"
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable .
	@touch $@

$(DEV): $(RUN)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt pip  # with --group, which older ones lack
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[report,dask,images,parquet,tune]' --group dev
	@touch $@

$(DOCS): $(RUN)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[docs]'
	@touch $@

quickstart: $(RUN)  ## Run the paper's comparison, short, and print its table (under 2 minutes)
	$(BIN)/meshfit run quickstart --runs $(RUNS)

# The tests start many processes, which share compiled modules, whatever the shell has set.
export PYTHONDONTWRITEBYTECODE :=

# One thread for each worker: with more they spin while they wait for each other, and take half as long again.
test: $(DEV)  ## Run the fast tests
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist worksteal -m "not slow"

shapes: $(DEV)  ## Run the fast tests with shapes and dtypes checked at every call (under 5 minutes)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist worksteal -m "not slow" $(SHAPE_CHECKS)

check: lint types layers test  ## Everything that has to pass: ruff, mypy --strict, layers, tests

lint: $(DEV)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(DEV)
	$(BIN)/mypy

layers: $(DEV)
	$(BIN)/lint-imports

table1: $(RUN)  ## Reproduce the paper's Table 1 in full: 5 seeds (under 15 minutes on 2 cores)
	$(BIN)/meshfit run table1 --runs $(RUNS)
	$(BIN)/meshfit table $(RUNS)/table1 --check configs/expected/table1.json

study: $(DEV)  ## Sample what Table 1 leaves open; writes docs/background/paper-study.md (80 minutes on 2 cores); resumes
	for name in $(STUDY); do $(BIN)/meshfit run $$name --runs $(RUNS) || exit $$?; done
	$(BIN)/meshfit figure $(RUNS)/table1-nearest/*/*/seed-0-* -o data/pictures/paper-study-nearest.png
	$(BIN)/python -m tests.benchmarks.paper_study $(RUNS) docs/background/paper-study.md data/pictures/paper-study.png

table1-nearest: $(RUN)  ## The settings whose numbers come nearest to the paper's, 5 seeds (10 minutes on 2 cores)
	$(BIN)/meshfit run table1-nearest --runs $(RUNS)
	$(BIN)/meshfit table $(RUNS)/table1-nearest --check configs/expected/table1-nearest.json

reproduce: $(DEV)  ## The short reproduction that CI runs, checked against its expected numbers
	$(BIN)/meshfit run reproduce --runs $(RUNS)
	$(BIN)/meshfit table $(RUNS)/reproduce --check configs/expected/reproduce.json
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist worksteal -m slow $(SHAPE_CHECKS)

bench: $(DEV)  ## Measure speed and memory, against plain twins in the same run; writes $(BENCH) (12 minutes)
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.benchmarks --json $(BENCH)

accuracy: $(RUN)  ## The Gauss–Newton engine on all five targets, three seeds, its three bundled configs (10 minutes)
	$(BIN)/meshfit run accurate --name accurate --runs $(RUNS) $(ALL_TARGETS)
	$(BIN)/meshfit run accurate-sphere --name accurate-sphere --runs $(RUNS) $(ALL_TARGETS)
	$(BIN)/meshfit run accurate-fixed --name accurate-fixed --runs $(RUNS) $(ALL_TARGETS)

docs: $(DOCS)  ## Build the documentation into site/, strictly
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict

ablation: $(DEV)  ## Leave out the Gauss–Newton engine's ingredients one by one; writes docs/background/ablation.md (15 minutes)
	$(BIN)/python -m tests.benchmarks.ablation > docs/background/ablation.md

bench-compare: $(DEV)  ## Compare two such files: make bench-compare OLD=a.json NEW=b.json
	$(BIN)/python -m tests.benchmarks.compare $(OLD) $(NEW)

kinds: $(DEV)  ## Draw the pictures of docs/guide/which-source.md from real fits (10 minutes)
	$(BIN)/python -m tests.benchmarks.target_pictures $(RUNS)/targets data/pictures/kinds

registration-bench: $(DEV)  ## Register templates to targets with known correspondence, other tools beside ours; resumes (40 minutes)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[peers]'
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.benchmarks.registration $(RUNS)/registration docs/background/registration.md

images-bench: $(DEV)  ## Fits to views of named targets; writes docs/background/images.md; resumes (30 minutes)
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.benchmarks.images $(RUNS)/images docs/background/images.md data/pictures/images.png

targets-bench: $(DEV)  ## Fits to targets of each kind, with other tools beside them; writes docs/background/targets.md (7 minutes)
	$(BIN)/python -m tests.benchmarks.targets > docs/background/targets.md

kills: $(DEV)  ## Kill runs 320 times, at known moments, and compare with undisturbed ones; resumes (20 minutes, Linux)
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.kills $(RUNS)/kills

figures: $(DEV)  ## Draw the README's pictures from real runs (under 10 minutes)
	$(BIN)/meshfit run table1 --runs $(RUNS) --set seeds=[0] --quiet
	$(BIN)/meshfit run accurate --runs $(RUNS) --quiet
	$(BIN)/meshfit render $(RUNS)/accurate/bunny/loop/seed-0-* -o data/pictures/fit.png
	$(BIN)/meshfit render bunny mousehead cow bone airplane -o data/pictures/targets.png
	$(BIN)/meshfit figure $(RUNS)/table1/*/*/seed-0-* -o data/pictures/table1.png --targets bunny,mousehead
	$(BIN)/meshfit figure $(RUNS)/accurate/*/*/seed-0-* -o data/pictures/accurate.png --targets bunny,mousehead
	$(BIN)/meshfit schemes interp-loop --analyse --plot data/pictures/interp-loop.png

zoo: $(DEV)  ## Every scheme on every target with both engines, and the chart in the README (half an hour)
	$(BIN)/meshfit run zoo --runs $(RUNS)
	$(BIN)/meshfit chart $(RUNS)/zoo -o data/pictures/zoo.png

mousehead: $(RUN)  ## Remake the mousehead target
	$(BIN)/python data/mousehead.py

wheel: $(RUN)  ## Build the wheel
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir dist .

clean:  ## Remove .venv, caches and builds; runs stay
	rm -rf $(VENV) dist build site .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
