# Bead chains on LIGGGHTS and YADE. "make" lists the targets.
PYTHON ?= python3
PY := .venv/bin/python
ENGINES := liggghts yade
FOUND := $(strip $(foreach engine,$(ENGINES),$(if $(shell command -v $(engine)),$(engine))))
STUDIES := $(basename $(notdir $(wildcard inputs/studies/*.toml)))
FIGURES := $(patsubst postproc/figures/%.py,%,$(wildcard postproc/figures/[a-z]*.py))
SOURCES := $(shell find inputs templates drivers postproc validation -type f -not -path '*/tests/*' -not -path '*/__pycache__/*' \
  -not -path 'inputs/studies/*' -not -path 'drivers/batch/*' -not -name study.py -not -name film.py -not -name vtk.py)
# what only the page and the comparison of runs need
PAGE := templates/report/% postproc/inline.py postproc/foreign.py validation/report/% validation/pair/% validation/departure/% validation/diagnosis/% validation/scenes.py
# what every figure depends on, beside its own module and scenes
COMMON := $(filter-out inputs/scenes/% inputs/paper/claims.toml postproc/figures/% $(PAGE) validation/claims/% validation/trade/% validation/stability/% validation/elements/% validation/independent/% inputs/extremes.toml inputs/elements.toml inputs/independent.toml \
  $(addprefix validation/,bench.py bench_batch.py comparison.py criteria.py deviation.py random_scenes.py rounding.py verdict.py __main__.py),$(SOURCES))
SCENES_fig1 := fig4
SCENES_fig2 := fig4 table1
SCENES_fig3 := table1
SCENES_fig4 := fig4
SCENES_fig5 := fig5
SCENES_fig6 := fig6b fig6d
SCENES_table1 := table1
# of whose chains the contact forces are shown as well
CHAINS := fig3 fig4 fig5 fig6 table1
BUDGET := 300
# of the report, where nobody has made the whole study
SHORT_BUDGET := 30
AS_ROOT := $(if $(filter 0,$(shell id -u)),,sudo)
APT := $(if $(shell command -v apt-get),$(if $(AS_ROOT),$(shell command -v sudo),yes))
INSTALL := $(AS_ROOT) env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends

.DEFAULT_GOAL := help
.PHONY: help setup cluster engines $(FIGURES) figures claims trade stability elements independent study report test test-long test-slurm test-accuracy test-page bench lint clean FORCE

help: ## list the targets
	@grep -hE '^[a-z0-9-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-10s %s\n", $$1, $$2}'

setup: .venv/.ready ## make .venv with the locked packages

cluster: .venv/.ready-cluster ## setup, and Dask for studies on many machines

engines: ## install LIGGGHTS and YADE where they are missing
	@$(MAKE) --no-print-directory .venv/.engines AGAIN=FORCE

fig1: ## the set-up to scale
fig2: ## sensor bead: free body, forces, the coefficient beta
fig3: ## speed against amplitude, with scores of the moduli
fig4: ## one solitary wave and its reflection
fig5: ## a heavy striker's train, envelope and incident pulse
fig6: ## small beads under a steel and a PTFE ball
table1: ## speeds and widths, solved for by every engine
figures: $(FIGURES) ## all figures and the table

claims: results/.claims ## every quantitative statement of the paper, computed

trade: results/.trade ## what accuracy costs on every engine: make trade [BUDGET=300], seconds of engine time

stability: results/.stability ## where engines break: limits, extremes, long runs, rounding

elements: results/.elements ## what each modelling element adds and costs, and what the experiment would have shown

independent: results/.independent ## cases beyond the paper: impacts, exact waves, trains, walls, by published numbers and theory

study: .venv/.ready .venv/.engines ## run a study and draw its figure: make study STUDY=sensitivity
	@test -n "$(STUDY)" || { echo "which? make study STUDY=$(firstword $(STUDIES)); there are $(STUDIES)"; exit 2; }
	$(PY) -m drivers batch $(STUDY)
	$(PY) -m postproc study $(STUDY)

report: results/.report ## run the paper's scenes on all engines and write results/report.html

test-accuracy: .venv/.ready-dev .venv/.engines ## accuracies on 200 random scenes, limits of the time step on 100
	$(PY) -m pytest -n 2 -m accuracy validation/tests/test_accuracy.py

test: .venv/.ready-dev .venv/.engines lint ## lint, types and tests
	$(PY) -m pytest -n 2 --dist loadfile

test-long: .venv/.ready-dev .venv/.engines ## figures, claims, chains in tubes, killed batches, Dask, films: what takes long
	$(PY) -m pytest -n 2 --dist loadfile -m long

test-slurm: .venv/.ready-dev ## studies on a real Slurm of this machine, installed where it is missing
	@command -v slurmctld >/dev/null && command -v munged >/dev/null || $(MAKE) --no-print-directory .slurm
	$(PY) -m pytest -m slurm validation/tests/test_slurm.py

test-page: .venv/.ready-dev .venv/.engines ## the report page in headless Chromium, installed where it is missing
	@command -v chromium >/dev/null && command -v chromedriver >/dev/null || $(MAKE) --no-print-directory .chromium
	$(PY) -m pytest -m page validation/tests/test_page.py

bench: .venv/.ready .venv/.engines ## what the integrators and engines cost, as ratios
	$(PY) -m validation bench

lint: .venv/.ready-dev ## ruff and mypy
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m mypy

clean: ## remove runs and results (not .venv)
	rm -rf runs results

# figures are made by one command each; a figure that failed leaves nothing
$(FIGURES): %: results/%.svg results/%.png results/%.csv
$(CHAINS): %: results/%-spacetime.svg results/%-spacetime.png results/%-spacetime.csv

.SECONDEXPANSION:
results/%.svg results/%.png results/%.csv: postproc/figures/%.py $$(addsuffix .toml,$$(addprefix inputs/scenes/,$$(SCENES_$$*))) $(COMMON) .venv/.ready .venv/.engines
	$(PY) -m postproc $*

# made with their figure: here only where somebody removed one
results/%-spacetime.svg results/%-spacetime.png results/%-spacetime.csv: results/%.svg results/%.png results/%.csv
	@for kind in svg png csv; do test -f results/$*-spacetime.$$kind || exec $(PY) -m postproc $*; done

results/.claims: $(filter-out postproc/figures/% $(PAGE) validation/stability/% validation/elements/% validation/independent/% inputs/extremes.toml inputs/elements.toml inputs/independent.toml,$(SOURCES)) .venv/.ready .venv/.engines $(if $(wildcard results/claims.csv),,FORCE)
	$(PY) -m validation claims
	@touch $@

results/.trade: $(filter-out postproc/figures/% $(PAGE) validation/claims/% validation/stability/% validation/elements/% validation/independent/% inputs/extremes.toml inputs/elements.toml inputs/independent.toml,$(SOURCES)) .venv/.ready .venv/.engines $(if $(wildcard results/trade.csv),,FORCE)
	$(PY) -m validation trade --budget $(BUDGET)
	@touch $@

results/.stability: $(filter-out postproc/figures/% $(PAGE) validation/claims/% validation/trade/% validation/elements/% validation/independent/% inputs/elements.toml inputs/independent.toml,$(SOURCES)) .venv/.ready .venv/.engines $(if $(wildcard results/stability.csv),,FORCE)
	$(PY) -m validation stability
	@touch $@

results/.elements: $(filter-out postproc/figures/% $(PAGE) validation/claims/% validation/trade/% validation/stability/% validation/independent/% inputs/extremes.toml inputs/independent.toml,$(SOURCES)) .venv/.ready .venv/.engines $(if $(wildcard results/elements.csv),,FORCE)
	$(PY) -m validation elements
	@touch $@

results/.independent: $(filter-out postproc/figures/% $(PAGE) validation/claims/% validation/trade/% validation/stability/% validation/elements/% inputs/extremes.toml inputs/elements.toml inputs/paper/claims.toml,$(SOURCES)) $(wildcard inputs/studies/*.toml drivers/batch/*.py) .venv/.ready .venv/.engines $(if $(wildcard results/independent.csv),,FORCE)
	$(PY) -m validation independent
	@touch $@

# the stamp stands only if every verdict is good; finished runs are not run again
# the page is written even if a claim or an independent case is at fault, but then the target fails
# what other targets have made since is put in as well
NEWS = $(shell find results -maxdepth 1 \( -name '*.csv' -o -name '*.svg' \) -newer results/.report 2>/dev/null)
results/.report: $(filter-out postproc/figures/%,$(SOURCES)) .venv/.ready .venv/.engines $(if $(wildcard results/report.html),$(if $(NEWS),FORCE),FORCE)
	@test -f results/trade.csv || $(PY) -m validation trade --budget $(SHORT_BUDGET)
	@test -f results/stability.csv || $(PY) -m validation stability --quick
	@test -f results/elements.csv || $(PY) -m validation elements --quick
	@$(MAKE) --no-print-directory results/.claims; claims=$$?; $(MAKE) --no-print-directory results/.independent; independent=$$?; \
	  $(PY) -m validation report && test $$claims = 0 && test $$independent = 0
	@touch $@

.venv/.ready: requirements.lock
	$(call make_venv)
	$(PY) -m pip install -q --disable-pip-version-check --require-hashes -r requirements.lock
	@touch $@

.venv/.ready-dev: requirements-dev.lock .venv/.ready
	$(PY) -m pip install -q --disable-pip-version-check --require-hashes -r requirements-dev.lock
	@touch $@

.venv/.ready-cluster: requirements-cluster.lock .venv/.ready
	$(PY) -m pip install -q --disable-pip-version-check --require-hashes -r requirements-cluster.lock
	@touch $@

# a .pth file puts the checkout on the path, so that python -m drivers works from any folder
define make_venv
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or later is needed: make PYTHON=python3.11"; exit 1; }
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || $(MAKE) --no-print-directory .python-venv
	$(PYTHON) -m venv .venv
	@$(PY) -c 'import os, pathlib, sysconfig; pathlib.Path(sysconfig.get_path("purelib"), "checkout.pth").write_text(os.getcwd() + "\n")'
endef

.PHONY: .python-venv
.python-venv:
	@test -n "$(APT)" || { echo "Python lacks the venv module: install it (Debian: python3-venv)"; exit 1; }
	@echo "installing python3-venv from the system's packages"
	$(AS_ROOT) apt-get update -qq
	$(INSTALL) -qq python3-venv >/dev/null

.PHONY: .slurm
.slurm:
	@test -n "$(APT)" || { echo "no Slurm here: install slurmctld, slurmd and munge"; exit 1; }
	$(AS_ROOT) apt-get update -qq
	$(INSTALL) -qq munge slurmctld slurmd slurm-client slurm-wlm-basic-plugins >/dev/null

.PHONY: .chromium
.chromium:
	@test -n "$(APT)" || { echo "no browser here: install chromium and its driver (Debian: chromium, chromium-driver)"; exit 1; }
	@echo "installing chromium and chromium-driver from the system's packages"
	$(AS_ROOT) apt-get update -qq
	$(INSTALL) -qq chromium chromium-driver >/dev/null

# remembers which engines were there; it is newer only when that changed
.venv/.engines: $(AGAIN) $(if $(filter-out $(shell cat .venv/.engines 2>/dev/null),$(FOUND)),FORCE) | .venv/.ready
ifneq ($(FOUND),$(ENGINES))
ifneq ($(APT),)
	@echo "installing the missing engines from the system's packages: $(filter-out $(FOUND),$(ENGINES))"
	-$(AS_ROOT) apt-get update -qq && $(INSTALL) -qq $(filter-out $(FOUND),$(ENGINES)) >/dev/null
else
	@echo "missing: $(filter-out $(FOUND),$(ENGINES)). On Debian 12: apt-get install liggghts yade. Going on without."
endif
endif
	@for engine in $(ENGINES); do command -v $$engine >/dev/null && printf '%s ' $$engine; done > $@.new; \
	  if cmp -s $@.new $@; then rm $@.new; else mv $@.new $@; fi
