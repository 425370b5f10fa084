# `make` alone lists what there is. A clean Debian 12 or 13 with git and make is enough to start.

PYTHON := .venv/bin/python

# Quadrature points run on numba's threads; BLAS and MUMPS threads beside them only get in the way.
export OMP_NUM_THREADS := 1
# mpirun refuses root unless told so (containers, CI), would pin all threads of a rank to one core,
# and tries the network although all ranks are on this machine. (PRTE: the name since Open MPI 5.)
export OMPI_ALLOW_RUN_AS_ROOT := 1
export OMPI_ALLOW_RUN_AS_ROOT_CONFIRM := 1
export OMPI_MCA_hwloc_base_binding_policy := none
export PRTE_MCA_hwloc_default_binding_policy := none
export OMPI_MCA_btl := ^tcp

.PHONY: help setup biaxial test lint format tradeoff figures clean

help: ## list the targets
	@sed -n 's/^\([a-z]*\):[^#]*## /  make \1\t/p' $(MAKEFILE_LIST) | expand -t 18

setup: .venv/ready ## install what is missing (Debian packages, .venv)

biaxial: setup ## the main scene: drained biaxial compression, into results/biaxial/
	$(PYTHON) demos/biaxial.py

test: setup ## all tests
	$(PYTHON) -m pytest --numprocesses auto --maxprocesses 4 --dist loadfile

lint: setup ## what CI checks of the style
	$(PYTHON) -m ruff format --check .
	$(PYTHON) -m ruff check .

format: setup ## bring the sources into that style
	$(PYTHON) -m ruff format .
	$(PYTHON) -m ruff check --fix .

tradeoff: setup ## measure speed against accuracy again, for docs/accuracy.md
	$(PYTHON) docs/make_figures.py tradeoff

figures: setup ## draw the pictures of the documentation again
	$(PYTHON) docs/make_figures.py

clean: ## remove .venv, caches and builds; results/ stays
	rm -rf .venv build .pytest_cache .ruff_cache .hypothesis *.egg-info
	find . -name __pycache__ -prune -exec rm -rf {} +

# /usr/bin/python3, because dolfinx belongs to Debian's Python, whatever python3 is on PATH.
# NumPy is held at Debian's version: Debian's petsc4py and dolfinx are compiled against it, so pip
# has to choose a numba that accepts it. A set-up cut short leaves no .venv/ready and is run again.
.venv/ready: debian-packages.txt pyproject.toml
	.ci/install-debian-packages
	/usr/bin/python3 -m venv --system-site-packages .venv
	/usr/bin/python3 -c 'import numpy; print("numpy==" + numpy.__version__)' > .venv/constraints.txt
	$(PYTHON) -m pip install --quiet --constraint .venv/constraints.txt --editable '.[test]'
	@touch $@
