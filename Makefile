# Bead chains on LIGGGHTS, YADE, LAMMPS and Kratos. "make" lists the targets.
PYTHON ?= python3
PY := .venv/bin/python
BEADS := .venv/bin/beads
export PATH := $(PATH):$(CURDIR)/.venv/bin
AS_ROOT := $(if $(filter 0,$(shell id -u)),,sudo)
APT := $(if $(shell command -v apt-get),$(if $(AS_ROOT),$(shell command -v sudo),yes))
# Kratos takes the place of LIGGGHTS and YADE if they cannot be installed; beside them: make engines CODES=kratos
PRESENT := $(shell command -v liggghts >/dev/null && command -v yade)
CODES := liggghts yade lammps $(if $(APT)$(PRESENT),,kratos)
# file with engines of your own: make report ENGINES=mine.toml
export BEAD_CHAINS_ENGINES := $(or $(abspath $(ENGINES)),$(BEAD_CHAINS_ENGINES))
ENTRIES := $(wildcard $(subst :, ,$(BEAD_CHAINS_ENGINES)) engines.toml $(HOME)/.config/bead-chains/engines.toml)
# codes whose program is on PATH or in .venv; make takes no output of a shell that ends with 127, "not found"
FIND = for engine in $(CODES); do program=$$(echo $$engine | sed 's/lammps/lmp/; s/kratos/kratos-python/'); \
  PATH="$$PATH:.venv/bin" command -v $$program >/dev/null && printf '%s ' $$engine || :; done
FOUND := $(strip $(shell $(FIND)))
MISSING := $(filter-out $(FOUND),$(CODES))
STUDIES := $(basename $(notdir $(wildcard inputs/studies/*.toml)))
FIGURES := $(patsubst postproc/figures/%.py,%,$(wildcard postproc/figures/[a-z]*.py))
# figures and studies depend on every source: finished runs are found by content, so a repetition is cheap
SOURCES := $(shell find inputs templates drivers postproc validation -type f \
  -not -path '*/tests/*' -not -path '*/__pycache__/*')
MADE_FROM := $(SOURCES) $(ENTRIES) .venv/.ready .venv/.engines
MEASURED := claims trade stability elements calibration
BUDGET := 300
INSTALL := $(AS_ROOT) env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends

.DEFAULT_GOAL := help
.PHONY: help setup cluster engine engines $(FIGURES) figures $(MEASURED) study report bench lint clean FORCE
.PHONY: test test-long test-slurm test-accuracy test-page

help: ## list these targets
	@grep -hE '^[a-z0-9-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-13s %s\n", $$1, $$2}'
	@awk -F '[.]?"""|[.]$$' 'FNR == 1 {split(FILENAME, part, "[/.]"); printf "  make %-13s %s\n", part[3], $$2}' \
	  $(FIGURES:%=postproc/figures/%.py)

setup: .venv/.ready ## create .venv with the locked packages and beads

cluster: .venv/.ready-cluster ## setup, with Dask for studies on a cluster

engines: ## install LIGGGHTS, YADE and LAMMPS if missing, or Kratos: CODES=kratos
	@$(MAKE) --no-print-directory .venv/.engines AGAIN=FORCE

figures: .venv/.ready .venv/.engines ## draw all figures and Table 1 of the paper
	@$(MAKE) --no-print-directory -j 2 $(FIGURES)

claims: ## judge the paper's statements, engines by published numbers

trade: ## measure error against cost; BUDGET=300 seconds of runs

stability: ## measure stable steps, extremes, long runs

elements: ## measure effect and cost of each modelling element

calibration: ## fit contact laws to the paper's experiments

study: .venv/.ready .venv/.engines ## run and draw a study: make study STUDY=sensitivity
	@test -n "$(STUDY)" || { echo "STUDY is missing: make study STUDY=$(firstword $(STUDIES)); studies: $(STUDIES)"; exit 2; }
	$(BEADS) batch $(STUDY)
	$(BEADS) study $(STUDY)

engine: .venv/.ready ## test an adapter or a build: make engine ENGINE=verlet
	@test -n "$(ENGINE)" || { echo "ENGINE is missing: make engine ENGINE=verlet"; exit 2; }
	$(BEADS) engine $(ENGINE)

report: results/.report ## run all scenes and write results/report.html

test: .venv/.ready-dev .venv/.engines lint ## run lint, types and tests
	$(PY) -m pytest -n 2 --dist loadfile

test-long: OPTIONS = -n 2 --dist loadfile
test-long: .cc ## run long tests: figures, claims, tubes, Dask, films
test-accuracy: OPTIONS = -n 2
test-accuracy: ## run accuracy tests on random scenes
test-slurm: .slurm ## run studies on a Slurm of this machine (installs it)
test-page: .chromium ## run tests of both pages in Chromium (installs it)
test-long test-accuracy test-slurm test-page: test-%: .venv/.ready-dev .venv/.engines
	$(PY) -m pytest -m $* $(OPTIONS)

bench: .venv/.ready-dev .venv/.engines ## measure costs: reference against verlet, batches, fits, live page
	$(PY) -m validation.tests.bench

lint: .venv/.ready-dev ## run ruff and mypy
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m mypy

clean: ## remove runs and results, and their cache (not .venv)
	rm -rf runs results .cache

# a stamp is written if its command succeeds, and is valid while the files of that command exist
.SECONDEXPANSION:
$(FIGURES) $(MEASURED): %: results/.%

$(FIGURES:%=results/.%): results/.%: $(MADE_FROM) \
    $$(if $$(filter 3,$$(words $$(wildcard $$(addprefix results/$$*.,csv png svg)))),,FORCE)
	$(BEADS) figures $*
	@touch $@

$(MEASURED:%=results/.%): results/.%: $(MADE_FROM) $$(if $$(wildcard results/$$*.csv),,FORCE)
	$(BEADS) $* $(if $(filter trade,$*),--budget $(BUDGET))
	@touch $@

# codes that have to run: all if make can install them, else those that are installed
REQUIRED = $(if $(APT),$(CODES),$(shell cat .venv/.engines))
# the page is written first, then extended by each figure and chapter; the stamp is written if no verdict is fail
# newer figures and chapters of other targets also make the report out of date
NEWS = $(shell find results/parts -name '*.json' -newer results/.report 2>/dev/null)
results/.report: $(MADE_FROM) $(if $(wildcard results/report.html),$(if $(NEWS),FORCE),FORCE)
	$(BEADS) report --studies $(REQUIRED:%=--require %)
	@touch $@ $(addprefix results/.,claims $(FIGURES))

# the stamp holds the path of the checkout, since a moved one needs its command and its "activate" again
MOVED = $(subst x$(CURDIR),,x$(shell cat .venv/.ready 2>/dev/null))
.venv/.ready: requirements.lock pyproject.toml $(if $(wildcard $(BEADS)),$(if $(MOVED),FORCE),FORCE)
	$(call make_venv)
	@$(call packages,requirements.lock)
	@$(PY) -m pip install -q --disable-pip-version-check --no-index --no-deps --no-build-isolation -e .
	@$(call talking,compiling the integrators for a minute or two, $(PY) -m validation.reference)
	@echo '$(CURDIR)' >$@

.venv/.ready-dev: requirements-dev.lock .venv/.ready
	@$(call packages,requirements-dev.lock)
	@touch $@

.venv/.ready-cluster: requirements-cluster.lock .venv/.ready
	@$(call packages,requirements-cluster.lock)
	@touch $@

# Python's packages of a lock file: $(call packages,FILE)
packages = $(call talking,Python's packages of $(1) into .venv, \
  $(PY) -m pip install --disable-pip-version-check --require-hashes -r $(1))

# run a command and show the last line that it printed, in place on a terminal: $(call talking,WORDS,COMMAND)
talking = echo "$(1)"; log=$$(mktemp) && trap 'rm -f $$log' EXIT; \
  if test -t 1; then line='\r\033[K  %.76s' pause=1; else line='  %.76s\n' pause=20; fi; \
  (while sleep $$pause >/dev/null && kill -0 $$$$; do \
    test ! -s $$log || printf "$$line" "$$(tail -n 1 $$log)"; \
  done) 2>/dev/null & talker=$$!; \
  { $(2); } >$$log; code=$$?; kill $$talker; ! test -t 1 || printf '\r\033[K'; exit $$code

define make_venv
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Python 3.11 or later is needed: make PYTHON=python3.11"; exit 1; }
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || $(MAKE) --no-print-directory .python-venv
	$(PYTHON) -m venv .venv
endef

# install packages of the system: $(call install,PACKAGES)
define install
{ test -n "$(APT)" || { echo "install these packages first: $(1)"; exit 1; }; \
  $(call talking,installing from the system's packages: $(1), \
  $(AS_ROOT) apt-get update -q && $(INSTALL) -q $(1)); }
endef

.PHONY: .python-venv .cc .slurm .chromium
.python-venv:
	@$(call install,python3-venv)

.cc:
	-@command -v cc >/dev/null || $(call install,gcc libc6-dev)

.slurm:
	@command -v slurmctld >/dev/null && command -v munged >/dev/null || \
	  $(call install,munge slurmctld slurmd slurm-client slurm-wlm-basic-plugins)

.chromium:
	@command -v chromium >/dev/null && command -v chromedriver >/dev/null || $(call install,chromium chromium-driver)

# installs from the system's packages, else, as Kratos always, from Python's; lists the found codes, rewritten only if
# they change
.venv/.engines: $(AGAIN) $(if $(filter-out $(shell cat .venv/.engines 2>/dev/null),$(FOUND)),FORCE) | .venv/.ready
ifneq ($(MISSING),)
	-@$(if $(APT),$(if $(filter-out kratos,$(MISSING)),$(call install,$(filter-out kratos,$(MISSING)))))
	-@$(if $(filter lammps,$(CODES)),$(FIND) | grep -q lammps || { $(call packages,requirements-lammps.lock); })
	-@$(if $(filter kratos,$(MISSING)),($(call packages,requirements-kratos.lock)) && ln -sf python .venv/bin/kratos-python)
	@for each in $(CODES); do $(FIND) | grep -q $$each || printf "%s " $$each; done >$@.new
	@test ! -s $@.new || echo "missing: $$(cat $@.new)- install it, or name your own build in engines.toml" \
	  "(see inputs/engines.toml), then: make engines. Continuing without it."
endif
	@$(FIND) >$@.new; if cmp -s $@.new $@; then rm $@.new; else mv $@.new $@; fi
