# After setup every recipe uses the environment in .venv, never the python of PATH.
PYTHON ?= python3
PIP_INSTALL := -m pip --disable-pip-version-check install --quiet
# $(call locked,PYTHON,SETS): install sets of requirements/, of which every file must have a known hash. They are
# complete, so that nothing else is looked for; what must be built is built by the setuptools of the first line.
locked = $(1) $(PIP_INSTALL) --require-hashes --no-deps -r requirements/build.txt && \
	$(1) $(PIP_INSTALL) --require-hashes --no-deps --no-build-isolation --use-pep517 \
		$(foreach set,$(2),-r requirements/$(set).txt)

.DEFAULT_GOAL := help
.PHONY: help setup setup-learn demo test nightly lint types site wheel second-python newest benchmark lock licences sbom audit check clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' Makefile | expand -t 20

setup: .venv/.setup ## create .venv with the command and the tools in it

setup-learn: .venv/.learn ## add what agents and clusters need (torch, stable-baselines3, ray, ...)

.venv/.setup: pyproject.toml $(foreach set,build core test dev,requirements/$(set).txt)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
		{ echo "Python 3.10 or newer is needed: make setup PYTHON=/path/to/python3"; exit 2; }
	@$(PYTHON) -c 'import ensurepip' || \
		{ echo "this Python cannot create environments: install its venv package (Debian: apt install python3-venv)"; exit 2; }
	$(PYTHON) -m venv --clear .venv
	@echo "installing the pinned packages into .venv, about a minute"
	$(call locked,.venv/bin/python,core test dev)
	.venv/bin/python $(PIP_INSTALL) --no-deps --no-build-isolation -e .
	@touch $@

.venv/.learn: .venv/.setup requirements/learn.txt
	$(call locked,.venv/bin/python,learn)
	.venv/bin/python $(PIP_INSTALL) -c constraints.txt torch # its file depends on the index: no hash is known
	@touch $@

.venv/.docs: .venv/.setup requirements/docs.txt
	$(call locked,.venv/bin/python,docs)
	@touch $@

demo: setup ## record and diagnose a mystery arm
	.venv/bin/gapscope demo --out out/demo

test: setup ## run the tests, a file at a time on every core
	OMP_NUM_THREADS=1 .venv/bin/python -m pytest -n auto --dist loadfile

nightly: setup ## run the tests that make test leaves out
	OMP_NUM_THREADS=1 .venv/bin/python -m pytest -n auto --dist loadfile -m nightly

lint: setup ## check style, format and the licences of dependencies
	.venv/bin/python -m ruff check
	.venv/bin/python -m ruff format --check
	.venv/bin/python .ci/licences.py

types: setup ## check types
	.venv/bin/python -m mypy

site: .venv/.docs ## build the documentation into out/site, warnings are errors
	NO_MKDOCS_2_WARNING=1 .venv/bin/python -m mkdocs build --strict
	@echo "out/site/index.html"

wheel: setup ## build the wheel, check what it holds, run it in a fresh environment
	rm -rf dist out/wheel
	.venv/bin/python -m build --quiet --no-isolation --outdir dist
	.venv/bin/python .ci/check_wheel.py dist/gapscope-*.whl dist/gapscope-*.tar.gz
	.venv/bin/python -m venv out/wheel/venv
	$(call locked,out/wheel/venv/bin/python,core)
	out/wheel/venv/bin/python $(PIP_INSTALL) --no-deps dist/gapscope-*.whl
	out/wheel/venv/bin/python -m pip check # what the wheel asks for is there
	cd out/wheel && venv/bin/gapscope demo --out demo
	out/wheel/venv/bin/python .ci/beside_others.py

second-python: wheel ## run the demo and a core of the tests on another Python, if there is one
	.ci/second_python

benchmark: setup ## measure times and memory, out/benchmarks; hours, and goes on where it was stopped
	OMP_NUM_THREADS=1 .venv/bin/python -m experiments.benchmarks

newest: ## run the demo and tests with the newest version of every dependency, in out/newest
	.ci/newest

out/tools/.made: requirements/build.txt requirements/tools.txt
	$(PYTHON) -m venv --clear out/tools
	$(call locked,out/tools/bin/python,tools)
	@touch $@

lock: out/tools/.made ## resolve the dependencies anew within constraints.txt and write requirements/, with hashes
	$(PYTHON) .ci/lock.py out/tools/bin/uv

licences: setup ## check the licences of all dependencies, and write docs/licences.md
	.venv/bin/python .ci/licences.py --write docs/licences.md

sbom: wheel out/tools/.made ## write what an installed wheel consists of as CycloneDX, out/gapscope.cdx.json
	out/tools/bin/cyclonedx-py environment --pyproject pyproject.toml --output-reproducible \
		--mc-type application -o out/gapscope.cdx.json out/wheel/venv/bin/python

audit: out/tools/.made ## look for known vulnerabilities of the pinned versions; needs the network
	$(PYTHON) .ci/audit.py out/tools/bin/pip-audit

check: test lint types site wheel ## all of these checks

clean: ## remove everything that was made here
	rm -rf .venv build dist out *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
