# Everything works from a bare clone: each target makes its own virtual environment in .venv first.
#   make demo    render, track and report a synthetic walk
#   make test    all tests
#   make lint    ruff and pyright
#   make blender Blender for the tests of animation, in .venv-bpy (it wants another numpy; Python 3.11)
#   make bench   milliseconds per frame by stage
#   make docs    the docs and the API reference as a site: out/site
#   make notebooks   run the notebooks: out/notebooks
#   make release-check   build wheel and sdist, try both in clean environments
#   make reproduce CASE=C-3 [SEEDS=0-7] [OUT=out/C-3]   a claim or table, measured again; without CASE what there is

VENV := .venv
PY := $(VENV)/bin/python
JOBS ?= 2
# Commands that tests start would else compile each module again.
unexport PYTHONDONTWRITEBYTECODE
.DEFAULT_GOAL := help
.PHONY: help demo test lint blender bench docs notebooks release-check reproduce clean

help:
	@sed -n 's/^#   //p' Makefile

# A Python of at least 3.11 that runs (a pyenv shim may exist and not run).
$(PY):
	@for python in $(PYTHON) python3.12 python3.11 python3.13 python3.14 python3 python; do \
	  if $$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then \
	    echo "using $$($$python --version) for $(VENV)"; exec $$python -m venv $(VENV); fi; \
	done; echo "twistcap needs Python 3.11 or newer: install one, or run make PYTHON=/path/to/python" >&2; exit 1

$(VENV)/run.stamp: pyproject.toml | $(PY)
	$(PY) -m pip install --quiet -e .
	@touch $@

$(VENV)/dev.stamp: pyproject.toml $(VENV)/run.stamp
	$(PY) -m pip install --quiet -e '.[dev]'
	@touch $@

demo: $(VENV)/run.stamp
	$(PY) -m twistcap.cli demo --out demo

test: $(VENV)/dev.stamp
	$(PY) -m pytest -n $(JOBS) --dist loadscope --no-loadscope-reorder $(ARGS)

blender:
	$(or $(PYTHON),python3.11) -m venv .venv-bpy
	.venv-bpy/bin/python -m pip install --quiet 'bpy>=4.5,<6'

lint: $(VENV)/dev.stamp
	$(PY) -m ruff check
	$(PY) -m ruff format --check
	$(PY) -m pyright

bench: $(VENV)/run.stamp
	$(PY) -m reproduce bench $(if $(SEEDS),--seeds $(SEEDS))

$(VENV)/docs.stamp: pyproject.toml $(VENV)/run.stamp
	$(PY) -m pip install --quiet -e '.[docs]'
	@touch $@

docs: $(VENV)/docs.stamp
	NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build --quiet --strict

$(VENV)/notebooks.stamp: pyproject.toml $(VENV)/run.stamp
	$(PY) -m pip install --quiet -e '.[notebooks]'
	@touch $@

notebooks: $(VENV)/notebooks.stamp
	PYTHONPATH=. $(PY) notebooks/run.py

release-check: $(PY)
	.ci/release-check $(PY)

reproduce: $(VENV)/run.stamp
	$(PY) -m reproduce $(or $(CASE),--list) $(if $(SEEDS),--seeds $(SEEDS)) $(if $(OUT),--out $(OUT))

clean:
	rm -rf $(VENV) demo build dist .pytest_cache .ruff_cache .hypothesis
	find src tests reproduce \( -name '*.nbi' -o -name '*.nbc' \) -delete
