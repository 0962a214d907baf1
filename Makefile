# Everything runs in .venv. The first target that needs .venv creates it.
#   make demo                      reproduce the results of the thesis in out/
#   make test                      run the tests, but not the longest ones
#   make demo PYTHON=python3.12    create .venv with this Python instead of the newest one

VENV := .venv
BIN := $(VENV)/bin
OUT := out
PYTHON ?=
PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --editable

.DEFAULT_GOAL := help
.NOTPARALLEL:
.PHONY: help demo test test-long test-all test-times quick lint types docs notebooks figures bench bench-more bench-inverse extremes soak clean distclean

help: ## list all targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-13s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))

demo: $(VENV)/installed ## reproduce the tables and figures of the thesis in out/ (2 minutes on two cores)
	@$(BIN)/python -m jaxwhisker reproduce --out $(OUT)/

test: $(VENV)/installed-dev ## run the tests of every feature and module, but no test that passed with the same sources
	@$(BIN)/python -m pytest --unchanged $(PYTEST_OPTIONS) -m "not long" --check-types $(TYPED)
	@$(BIN)/python -m pytest --unchanged $(PYTEST_OPTIONS) -m "not long" $(addprefix --ignore=,$(TYPED))

test-long: $(VENV)/installed-dev ## run the longest tests, which tests/long.txt lists
	@$(BIN)/python -m pytest --unchanged -m long -rs --no-loadscope-reorder $$(sed 's/::.*//' tests/long.txt | sort -u)

test-all: $(VENV)/installed-dev ## run all tests, and enforce types and shapes of all arguments
	@$(BIN)/python -m pytest --check-types

test-times: $(VENV)/installed-dev ## run the tests with empty caches, and list those that take longest in docs/developing.md
	@$(BIN)/python benchmarks/time_of_tests.py && $(BIN)/python benchmarks/report.py

quick: $(VENV)/installed-dev ## run the tests of equilibria, paths, exact scans and models, after an edit (a minute and a half)
	@$(BIN)/python -m pytest --quiet $(CORE_TESTS)

lint: $(VENV)/installed-dev ## check style and formatting (ruff)
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .

types: $(VENV)/installed-dev ## check types (pyright)
	@$(BIN)/pyright

docs: $(VENV)/installed-docs ## build the documentation in out/site (EXECUTE=1: with notebook outputs, 15 minutes)
	@NO_MKDOCS_2_WARNING=1 EXECUTE_NOTEBOOKS=$(if $(EXECUTE),true,false) $(BIN)/mkdocs build --quiet --strict

notebooks: $(VENV)/installed-dev ## run all notebooks and save them with outputs in out/notebooks (10 to 20 minutes)
	@mkdir -p $(OUT)/notebooks
	@for notebook in notebooks/*.py; do \
	    name=$$(basename $$notebook .py); echo "== $$name"; \
	    $(BIN)/jupytext --quiet --set-kernel python3 --to ipynb --execute --run-path notebooks --output $(OUT)/notebooks/$$name.ipynb $$notebook || exit 1; \
	done

figures: $(VENV)/installed-dev ## draw the figures of the documentation and write the page on the thesis (10 minutes)
	@for script in figures/*.py; do $(BIN)/python $$script || exit 1; done

bench: $(VENV)/installed-bench ## measure error and run time, compare simulators (90 minutes; QUICK=1: three minutes)
	@$(if $(QUICK),$(BIN)/python benchmarks/work_precision.py --quick,$(call run,work_precision space_precision several_precision motion_precision growth cold_start ladder roofline space_rod report) && $(draw))

bench-more: $(VENV)/installed-dev ## measure gradients, studies, supports, films and sliders (needs ffmpeg, chromium)
	@$(call run,gradient_cost study_speed critical_map settings showing report) && $(draw)

bench-inverse: $(VENV)/installed-dev ## measure fits, contours and required prior knowledge (an hour)
	@$(call run,identify reconstruct known known_friction report) && $(draw)

extremes: $(VENV)/installed-dev ## scan scenes at the limits of every parameter's range
	@$(call run,extremes space_extremes report) && $(draw)

soak: $(VENV)/installed-dev ## check 150,000 random scenes (two hours on two cores)
	@$(call run,soak soak_supports soak_friction soak_shafts soak_curved soak_space report)

# Packages whose tests enforce types and shapes of all arguments, which costs time.
TYPED := tests/base tests/model tests/rod

# Everything that a scan rests on, without the tests that need further programs.
CORE_TESTS := tests/equilibrium tests/path tests/physics/test_reference_scans.py \
    tests/base/test_leaves.py tests/base/test_linear_algebra.py tests/docs/test_layout.py \
    $(filter-out $(addprefix tests/model/test_,motion.py contour.py profiles.py),$(wildcard tests/model/*.py))

run = for name in $(1); do echo "== $$name"; $(BIN)/python benchmarks/$$name.py || exit 1; done
draw = $(BIN)/python figures/results.py

clean: ## remove results, caches and build products, but keep .venv
	@rm -rf $(OUT) build dist .cache .pytest_cache .ruff_cache .hypothesis src/*.egg-info
	@find src tests benchmarks docs_hooks figures notebooks -name __pycache__ -prune -exec rm -rf {} + 2>/dev/null || true

distclean: clean ## run clean and remove .venv as well
	@rm -rf $(VENV)

# Use the newest Python that can create an environment. A fresh Debian lacks ensurepip.
CANDIDATES := $(or $(PYTHON),python3.13 python3.12 python3.11 python3)
$(BIN)/python:
	@recent='import sys; assert sys.version_info >= (3, 11)'; \
	complete="$$recent; import ensurepip, venv"; \
	for python in $(CANDIDATES); do \
	    "$$python" -c "$$complete" >/dev/null 2>&1 || continue; \
	    echo "creating $(VENV) with $$("$$python" --version) ($$python)"; \
	    "$$python" -m venv $(VENV) && exit 0; \
	    rm -rf $(VENV); exit 1; \
	done; \
	for python in $(CANDIDATES); do \
	    "$$python" -c "$$recent" >/dev/null 2>&1 || continue; \
	    echo "$$python cannot create an environment: its venv module is incomplete. On Debian: apt install python3-venv" >&2; \
	    exit 1; \
	done; \
	echo "Python 3.11 or later not found, tried $(CANDIDATES). On Debian: apt install python3 python3-venv" >&2; exit 1

$(VENV)/installed: pyproject.toml | $(BIN)/python
	@echo "installing jaxwhisker into $(VENV)"
	@$(PIP_INSTALL) '.[study,explore]'
	@touch $@

$(VENV)/installed-docs: pyproject.toml | $(BIN)/python
	@echo "installing jaxwhisker and what its documentation needs into $(VENV)"
	@$(PIP_INSTALL) '.[notebooks,docs]'
	@touch $@

$(VENV)/installed-bench: pyproject.toml | $(BIN)/python
	@echo "installing jaxwhisker, its test dependencies and other simulators into $(VENV)"
	@$(PIP_INSTALL) '.[dev,bench]'
	@touch $(VENV)/installed $(VENV)/installed-dev $(VENV)/installed-docs $@

$(VENV)/installed-dev: pyproject.toml | $(BIN)/python
	@echo "installing jaxwhisker and its test dependencies into $(VENV)"
	@$(PIP_INSTALL) '.[dev]'
	@touch $(VENV)/installed $(VENV)/installed-docs $@
