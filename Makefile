# After setup every recipe uses the environment in .venv, never the python of PATH.
PYTHON ?= python3
PIP_INSTALL := -m pip --disable-pip-version-check install --quiet -c constraints.txt

.DEFAULT_GOAL := help
.PHONY: help setup setup-learn demo test lint types site wheel second-python benchmark check clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' Makefile | expand -t 20

setup: .venv/.setup ## create .venv with the command and the tools in it

setup-learn: .venv/.learn ## add what agents and clusters need (torch, stable-baselines3, ray, ...)

.venv/.setup: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
		{ echo "Python 3.10 or newer is needed: make setup PYTHON=/path/to/python3"; exit 2; }
	@$(PYTHON) -c 'import ensurepip' || \
		{ echo "this Python cannot create environments: install its venv package (Debian: apt install python3-venv)"; exit 2; }
	$(PYTHON) -m venv --clear .venv
	@echo "installing the pinned packages into .venv, about a minute"
	.venv/bin/python $(PIP_INSTALL) -e '.[dev]'
	@touch $@

.venv/.learn: .venv/.setup
	.venv/bin/python $(PIP_INSTALL) -e '.[cluster,learn]'
	@touch $@

.venv/.docs: .venv/.setup
	.venv/bin/python $(PIP_INSTALL) -e '.[docs]'
	@touch $@

demo: setup ## record and diagnose a mystery arm
	.venv/bin/gapscope demo --out out/demo

test: setup ## run the tests, a file at a time on every core
	OMP_NUM_THREADS=1 .venv/bin/python -m pytest -n auto --dist loadfile

lint: setup ## check style and format
	.venv/bin/python -m ruff check
	.venv/bin/python -m ruff format --check

types: setup ## check types
	.venv/bin/python -m mypy

site: .venv/.docs ## build the documentation into out/site, warnings are errors
	NO_MKDOCS_2_WARNING=1 .venv/bin/python -m mkdocs build --strict
	@echo "out/site/index.html"

wheel: setup ## build the wheel, check what it holds, run it in a fresh environment
	rm -rf dist out/wheel
	.venv/bin/python -m build --quiet --outdir dist
	.venv/bin/python .ci/check_wheel.py dist/gapscope-*.whl dist/gapscope-*.tar.gz
	.venv/bin/python -m venv out/wheel/venv
	out/wheel/venv/bin/python $(PIP_INSTALL) dist/gapscope-*.whl
	cd out/wheel && venv/bin/gapscope demo --out demo
	out/wheel/venv/bin/python .ci/beside_others.py

second-python: wheel ## run the demo and a core of the tests on another Python, if there is one
	.ci/second_python

benchmark: setup ## measure times and memory, out/benchmarks; hours, and goes on where it was stopped
	OMP_NUM_THREADS=1 .venv/bin/python -m experiments.benchmarks

check: test lint types site wheel ## all of these checks

clean: ## remove everything that was made here
	rm -rf .venv build dist out *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
