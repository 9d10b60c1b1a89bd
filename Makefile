# Everything runs from the repository root through .venv; nothing is installed into the system.

.PHONY: help setup demo gallery test test-all fuzz lock lint format docs clean bench stability curves scaling ablation profile figures bench-farm bench-scans bench-formats bench-sunlit bench-mirrors bench-patterns bench-profiles bench-states
.DEFAULT_GOAL := help

VENV := .venv
STAMP := $(VENV)/.installed
SUPPORTED := import sys; sys.exit(sys.version_info[:2] not in ((3, 11), (3, 13)))
# A name on PATH may be a shim that does not run, so each candidate is asked.
PYTHON ?= $(shell for p in python3.11 python3.13 python3 python; do \
	if $$p -c '$(SUPPORTED)' 2>/dev/null; then echo $$p; break; fi; done)

help:
	@echo "make setup      create $(VENV) with everything pinned in pyproject.toml"
	@echo "make demo       solve, relight and report the bundled room into out/demo"
	@echo "make gallery    the pictures of the README from the bundled room, into docs/images"
	@echo "make test       unit tests;  make test-all  the slow ones too"
	@echo "make test-blender  real Blenders 4.3 and 5.2 by mouse, as root on Debian;  make test-wheels  bpy 4.5 and 5.2"
	@echo "make bench      speed against accuracy with peers, 1½ hours;  make profile  where the time goes, minutes"
	@echo "make stability  every perturbation, 1½ hours;  make scaling  cost against size, 20 minutes"
	@echo "make ablation   what each refinement earns, capture by capture, 2 hours"
	@echo "make curves     measured responses, exposures known and withheld, half an hour"
	@echo "make bench-scans scans beside the exact meshes of the same rooms, ten minutes"
	@echo "make bench-formats the bundled room in every format that is read, beside the original, half an hour"
	@echo "make bench-sunlit three rooms lit by sun and sky, rendered first, 20 minutes"
	@echo "make bench-mirrors two rooms with a mirror and one with steel, rendered first"
	@echo "make bench-patterns a room with a screen, one with a window over trees and one with an even window, rendered first"
	@echo "make bench-profiles a room with spots, one with a shielded panel and one with even lamps, rendered first"
	@echo "make bench-states a room photographed with different lamps on, with all on, and without a word on it, rendered first"
	@echo "make bench-farm jobs per hour of a batch, one after the other and two at a time, a quarter of an hour"
	@echo "make figures    charts and tables out of what was measured; nothing is measured"
	@echo "make fuzz       damaged files for every reader, SECONDS=600;  make lock  hashes of what the solver installs"
	@echo "make lint       ruff, pyright, what may import what;  make format  let ruff format"
	@echo "make docs       the documentation as a site, into out/site"

setup: $(STAMP)

# pip has no way to install the dependencies of a project without the project, hence the list written first.
$(STAMP): pyproject.toml
	@if [ ! -x $(VENV)/bin/python ]; then \
		if ! "$(PYTHON)" -c '$(SUPPORTED)' 2>/dev/null; then \
			echo "error: Python 3.11 or 3.13 is needed, Blender's bpy exists for no other —" \
				"install one of them, or name it: make setup PYTHON=/path/to/python3.11" >&2; exit 4; fi; \
		"$(PYTHON)" -m venv $(VENV); fi
	@$(VENV)/bin/python -c '$(SUPPORTED)' || { \
		echo "error: $(VENV) has another Python than 3.11 or 3.13 — remove $(VENV) and run make setup again" >&2; exit 4; }
	@echo "Installing Blender, torch and the rest into $(VENV); the first time takes some minutes."
	@$(VENV)/bin/python -c 'import tomllib; p = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
		o = p["optional-dependencies"]; print(*p["dependencies"], *o["formats"], *o["cuda"], *o["blender"], *o["dev"], sep="\n")' > $(VENV)/requirements.txt
	@$(VENV)/bin/python -m pip install -qq --disable-pip-version-check -r $(VENV)/requirements.txt
	@touch $@

gallery: $(STAMP)
	@$(VENV)/bin/python assets/make_gallery.py

demo: $(STAMP)
	@$(VENV)/bin/python headless/run.py demo

test: $(STAMP)
	@$(VENV)/bin/python -m pytest

test-all: $(STAMP)
	@$(VENV)/bin/python -m pytest -m ""

# SUITES="trixie sid" names Debian's suites, SECONDS a limit. Skips with its reason where a machine cannot do it.
SUITES ?= trixie sid
SECONDS ?= 0
test-blender: $(STAMP)
	@$(VENV)/bin/python -m tests.real_blender --suites "$(SUITES)" --seconds $(SECONDS)

test-wheels: $(STAMP)
	@tests/real_blender/wheels.sh

# What breaks a reader is kept under tests/strangers/corpus, and every test run reads that.
fuzz: $(STAMP)
	@$(VENV)/bin/python -m tests.strangers.fuzz --seconds $(or $(filter-out 0,$(SECONDS)),600)

lock: $(VENV)/.lock
	@$(VENV)/bin/python assets/make_solver_lock.py

lint: $(STAMP)
	@$(VENV)/bin/ruff check --quiet
	@$(VENV)/bin/ruff format --check --quiet
	@$(VENV)/bin/pyright --warnings
	@$(VENV)/bin/lint-imports --no-logo --no-cache > $(VENV)/contracts.txt || { cat $(VENV)/contracts.txt; exit 1; }

format: $(STAMP)
	@$(VENV)/bin/ruff check --fix --quiet
	@$(VENV)/bin/ruff format --quiet

# Documentation, benchmarks and the lock need packages of their own, the extras "docs", "bench" and "lock".
$(VENV)/.docs $(VENV)/.bench $(VENV)/.lock: $(VENV)/.%: $(STAMP)
	@$(VENV)/bin/python -c 'import tomllib; p = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
		print(*p["optional-dependencies"]["$*"], sep="\n")' > $(VENV)/requirements-$*.txt
	@$(VENV)/bin/python -m pip install -qq --disable-pip-version-check -r $(VENV)/requirements-$*.txt
	@touch $@

docs: $(VENV)/.docs
	@NO_MKDOCS_2_WARNING=1 $(VENV)/bin/python -m mkdocs build --quiet --strict

# Each benchmark goes on where it was stopped.
bench stability curves scaling ablation: $(VENV)/.bench
	@$(VENV)/bin/python -m benchmarks.$@

# Jobs per hour of a batch, on an idle machine.
bench-scans: $(VENV)/.bench
	@$(VENV)/bin/python -m benchmarks.scans

bench-formats: $(VENV)/.bench
	@$(VENV)/bin/python -m benchmarks.formats

bench-sunlit: $(VENV)/.bench
	@$(VENV)/bin/python -m benchmarks.made_rooms sunlit

bench-mirrors: $(VENV)/.bench
	@$(VENV)/bin/python -m benchmarks.made_rooms mirrors

bench-patterns: $(VENV)/.bench
	@$(VENV)/bin/python -m benchmarks.made_rooms patterns

bench-profiles: $(VENV)/.bench
	@$(VENV)/bin/python -m benchmarks.made_rooms profiles

bench-states: $(VENV)/.bench
	@$(VENV)/bin/python -m benchmarks.made_rooms states

bench-farm: $(VENV)/.bench
	@$(VENV)/bin/python -m benchmarks.farm

profile: $(VENV)/.bench
	@$(VENV)/bin/python -m benchmarks.profile_floor

figures: $(VENV)/.bench
	@$(VENV)/bin/python -m benchmarks.report

clean:
	rm -rf out dist build *.egg-info .cache .import_linter_cache .pytest_cache .ruff_cache
