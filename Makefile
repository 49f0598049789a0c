# What `make` alone prints comes from the `##` comments.
SHELL := /bin/bash
PYTHON ?= python3
EXTRAS ?= dev
PYTEST_ARGS ?=
MASKS ?= 100
SEED := $(or $(SEED),$(shell od -An -N3 -tu4 /dev/urandom | tr -d ' '))

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.set-up-$(EXTRAS)
PYTEST := $(BIN)/pytest -n 2 --dist=worksteal

# Without bytecode each of the hundred processes that tests start would compile the project anew.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help setup demo docs test test-all coverage bench campaigns lint types wheel constraints clean

help: ## this list
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 22

setup: $(STAMP) ## everything for developers into .venv, once; EXTRAS=dev,cluster for more, EXTRAS= for less

SET_UP_BY := pyproject.toml constraints.txt packit_sim/core/version.py scripts/setup.sh scripts/slim-pybullet.sh scripts/system-packages.sh

$(STAMP): $(SET_UP_BY)
	@bash scripts/system-packages.sh $(if $(EXTRAS),egl chromium,egl)
	@bash scripts/setup.sh '$(PYTHON)' '$(EXTRAS)'
	@touch $@

demo: ## evolve a pack, let agents repack its items, draw the results; installs only what this needs
	@ls $(VENV)/.set-up-* > /dev/null 2>&1 || $(MAKE) --no-print-directory setup EXTRAS=
	@$(BIN)/packit demo

test: $(STAMP) ## the quick tests
	@$(PYTEST) -m 'not slow' $(PYTEST_ARGS)

test-all: ## the slow tests too, with new seeds; MASKS=2000: number of masks; SEED=1: repeat a run
	@$(MAKE) --no-print-directory setup EXTRAS=dev,cluster
	@echo "to repeat this run: make test-all MASKS=$(MASKS) SEED=$(SEED)"
	@HYPOTHESIS_PROFILE=$${HYPOTHESIS_PROFILE:-all} $(PYTEST) --masks $(MASKS) --seed $(SEED) \
		--hypothesis-seed $(SEED) $(PYTEST_ARGS)

coverage: $(STAMP) ## the quick tests, and the share of lines and branches that they execute
	@$(BIN)/coverage erase
	@$(BIN)/coverage run -m pytest -n 2 --dist=worksteal -m 'not slow' $(PYTEST_ARGS)
	@$(BIN)/coverage combine --quiet
	@$(BIN)/coverage report --skip-covered

bench: ## the benchmarks that take minutes, one after the other
	@$(MAKE) --no-print-directory setup EXTRAS=dev,bench,cluster
	@$(BIN)/python -m benchmarks.placement
	@$(BIN)/python -m benchmarks.library
	@$(BIN)/python -m benchmarks.env
	@$(BIN)/python -m benchmarks.pictures
	@$(BIN)/python -m benchmarks.viewer
	@$(BIN)/python -m benchmarks.cluster

campaigns: ## the campaigns of the trust pages, anew: a night on two cores
	@$(MAKE) --no-print-directory setup EXTRAS=dev,campaign,cluster
	@$(BIN)/python -m campaigns

lint: $(STAMP) ## ruff: rules and format; pydoclint: docstrings; import-linter: who may import whom
	@$(BIN)/ruff check
	@$(BIN)/ruff format --check
	@$(BIN)/pydoclint --version > /dev/null  # types in docstrings give shapes (DOC105); kernels have no hints (DOC106, DOC107)
	@# A parameter without an entry is fine (DOC101, half of DOC103); an entry without a parameter is not (DOC102, DOC103).
	@! $(BIN)/pydoclint packit_sim agents benchmarks campaigns scripts 2>&1 | grep -E 'DOC|Error' \
		| grep -vP 'DOC10[1567]|DOC103(?!.*in the docstring but not)'
	@$(BIN)/lint-imports --no-cache > /dev/null || $(BIN)/lint-imports --no-cache

types: $(STAMP) ## mypy; of the package also as on Windows and macOS
	@$(BIN)/mypy
	@$(BIN)/mypy --platform win32 --cache-dir .mypy_cache/win32 packit_sim agents/packit_agents
	@$(BIN)/mypy --platform darwin --cache-dir .mypy_cache/darwin packit_sim agents/packit_agents

docs: $(STAMP) ## the documentation site, into build/site; a warning is an error
	@rm -rf docs/reference/api
	@$(BIN)/sphinx-build -q -W -n --keep-going -d build/doctrees docs build/site
	@echo "open build/site/index.html"

wheel: $(STAMP) ## sdist, and from it the wheel, into dist/
	@rm -rf dist
	@$(BIN)/python -m build --no-isolation

constraints: ## rewrite constraints.txt with the newest versions that fit
	@bash scripts/constraints.sh $(PYTHON)

clean: ## remove everything that was generated, .venv too
	rm -rf $(VENV) build demo dist .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
