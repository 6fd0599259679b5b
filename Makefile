# rths: two commands matter. `make run` recomputes the paper's tables, `make test` checks the project.
PYTHON ?= python3
VENV ?= .venv
# An active virtual environment is used as it is.
ifdef VIRTUAL_ENV
VENV := $(VIRTUAL_ENV)
endif
BIN := $(VENV)/bin
# Each test process collects all tests and loads all code, half a minute of a processor: as many as processors.
WORKERS ?= $(shell env -u OMP_NUM_THREADS -u OMP_THREAD_LIMIT nproc 2>/dev/null || sysctl -n hw.ncpu)
PYTEST := $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal
RUN_STAMP := $(VENV)/.rths-run
DEV_STAMP := $(VENV)/.rths-dev
DOCS_STAMP := $(VENV)/.rths-docs
SITE := build/site_source
# pip translates one file after another, tests of the libraries too: half a minute that all processors do in ten seconds.
# Ours are translated, too: where Python may not write bytecode, each command would translate them anew (0.7 s).
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -e
TRANSLATE := $(BIN)/python -m compileall -qq -j 0 -x 'site-packages/.*/tests?/' $(VENV)/lib rths_cli || true
CASES := $(foreach r,el_centro hachinohe,$(foreach d,low high,$(foreach c,ff ff_fb,configs/$(r)_$(d)_$(c).yaml)))

.PHONY: help run test campaign processors check bench docs dist clean

help: ## show this list
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 10

run: $(RUN_STAMP) ## install, run the paper's eight cases, print its tables beside ours
	@$(BIN)/rths run --paper --series essential --method paper --method best --output results $(CASES)
	@echo
	@echo "To call rths yourself: source $(BIN)/activate, then for example: rths run configs/el_centro_low_ff_fb.yaml"

test: $(DEV_STAMP) ## install with the test tools and run the tests (minutes)
	@$(PYTEST) -m "not campaign" tests

campaign: $(DEV_STAMP) ## all tests, with long sweeps, every page and short forms of the campaigns (an hour)
	@$(PYTEST) tests

processors: $(DEV_STAMP) ## run the tests as generic x86-64, Haswell, Skylake with AVX-512 and Zen would
	@$(BIN)/python benchmarks/processors.py -n $(WORKERS) tests

check: $(DEV_STAMP) ## lint, types, import layers
	@$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/mypy && $(BIN)/lint-imports

bench: $(DEV_STAMP) ## speed against C, numpy, scipy, python-control, and of whole commands (about 4 minutes)
	@$(BIN)/python benchmarks/run.py

docs: $(DOCS_STAMP) ## build a site from README and docs/ in build/site; a broken link ends it
	@rm -rf $(SITE) && mkdir -p $(SITE)/benchmarks
	@cp -R README.md LICENSE docs configs records examples $(SITE) && cp benchmarks/README.md $(SITE)/benchmarks
	@$(BIN)/mkdocs build --strict && echo "open build/site/index.html"

dist: $(DEV_STAMP) ## build wheel and sdist, install the wheel into an empty environment and run a case there
	@rm -rf dist && $(BIN)/python -m build --no-isolation --outdir dist .
	@$(BIN)/python benchmarks/try_wheel.py dist/*.whl && ls dist

clean: ## remove the environment and the results
	rm -rf .venv results build dist

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit("rths needs Python 3.11 or newer, this is " + sys.version.split()[0] + "; call make PYTHON=python3.11 ...") if sys.version_info < (3, 11) else None'
	@echo "creating the virtual environment $(VENV)"
	@$(PYTHON) -m venv $(VENV)

$(RUN_STAMP): pyproject.toml | $(BIN)/python
	@echo "installing rths into $(VENV) (about a minute)"
	@$(INSTALL) . && ($(TRANSLATE))
	@touch $@

$(DEV_STAMP): pyproject.toml | $(BIN)/python
	@echo "installing rths and its test tools into $(VENV) (about a minute)"
	@$(INSTALL) '.[dev]' && ($(TRANSLATE))
	@touch $@

$(DOCS_STAMP): pyproject.toml | $(BIN)/python
	@$(INSTALL) '.[docs]'
	@touch $@
