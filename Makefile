# Two commands do everything on a fresh machine: `make demo` and `make test`.
SHELL := /bin/bash
# The distribution of ROS 2: one of those with requirements-ros-<name>.txt, each in a virtual
# environment of its own.
ROS = jazzy
VENV = $(if $(filter jazzy,$(ROS)),.venv,.venv-$(ROS))
PY = $(VENV)/bin/python
PIP = $(PY) -m pip --disable-pip-version-check
PROVIDED := $(patsubst requirements-ros-%.txt,%,$(wildcard requirements-ros-*.txt))
ifeq ($(filter $(ROS),$(PROVIDED)),)
$(error ROS is '$(ROS)', expected one of: $(PROVIDED); the others have no wheels on PyPI (README.md))
endif

# What of the user's shell must not reach pip, Python and ROS here is named in one table.
FOREIGN := $(shell sed -n "s/^    '\([A-Z_]*\)',$$/\1/p" explore_slam/environment.py)
unexport $(FOREIGN)
# some hundred processes of one run would each compile the package's modules again
unexport PYTHONDONTWRITEBYTECODE
export PIP_USER := 0
export PIP_NO_WARN_SCRIPT_LOCATION := 1

# After a move of the clone or an update of Python, the virtual environment is made anew.
ifeq ($(filter clean,$(MAKECMDGOALS))$(findstring n,$(firstword -$(MAKEFLAGS))),)
STALE := $(shell env $(FOREIGN:%=-u %) tools/why_stale '$(VENV)')
ifneq ($(STALE),)
$(info $(VENV) is made anew: $(STALE))
$(shell rm -rf '$(VENV)')
endif
endif

TESTS_WITH_NODES := test/test_live_demo.py test/test_readme.py test/live test/nodes test/test_install.py

.PHONY: demo test lint types unit bench experiments test-lowest setup setup-dev clean

demo: setup
	@$(VENV)/bin/explore_slam demo $(ARGS)

test: setup-dev lint types unit

lint: setup-dev
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/ruff check .

types: setup-dev
	$(VENV)/bin/mypy

# ARGS: options and paths of pytest, for a part of the tests. All of them run in two processes. Those
# with nodes come last, the longest ones first: they mostly wait for processes of their own.
unit: setup-dev
ifdef ARGS
	$(PY) -m pytest $(ARGS)
else
	$(PY) -m pytest -n 2 --dist loadfile $(addprefix --ignore=,$(TESTS_WITH_NODES))
	$(PY) -m pytest -n 2 --dist loadfile --no-loadscope-reorder $(TESTS_WITH_NODES)
endif

bench: setup-dev
	$(PY) benchmarks/run.py $(ARGS)

experiments: setup-dev
	for name in 1 2 3 4 laps; do $(VENV)/bin/explore_slam experiment $$name || exit 1; done

# the versions that Ubuntu 24.04 has
test-lowest:
	$(MAKE) VENV=$(VENV)-lowest CONSTRAINTS=requirements-lowest.txt unit

setup: $(VENV)/.ready
setup-dev: $(VENV)/.ready-dev

$(VENV)/bin/python:
	@python=$$(tools/find_python) && echo "Making $(VENV) with $$python" && "$$python" -m venv $(VENV)

$(VENV)/.ready: requirements.txt requirements-ros-$(ROS).txt setup.py package.xml $(CONSTRAINTS) | $(VENV)/bin/python
	@echo "Installing ROS 2 ($(ROS)) and what else is needed from PyPI (a minute or two) ..."
	@$(PIP) install -q -r requirements.txt -r requirements-ros-$(ROS).txt $(if $(CONSTRAINTS),-c $(CONSTRAINTS)) 'setuptools<80' 2> >(grep -v 'is ignored: it is neither' >&2)
	@$(PIP) install -q --no-deps --no-build-isolation -e .
	@$(PY) tools/build_messages.py tf2_msgs map_msgs
	@tools/check_libraries $(PY)
	@echo "Compiling kernels (once) ..."
	@$(PY) -c 'from explore_slam import agent, simulation; agent.warm_up(); simulation.warm_up()'
	@touch $@

$(VENV)/.ready-dev: requirements-dev.txt $(wildcard interfaces/nav2_msgs/*/*) $(VENV)/.ready
	@echo "Installing what tests and benchmarks need ..."
	@$(PY) tools/build_messages.py nav2_msgs
	@$(PIP) install -q -r requirements-dev.txt $(if $(CONSTRAINTS),-c $(CONSTRAINTS)) 2> >(grep -v 'is ignored: it is neither' >&2)
	@touch $@

clean:
	rm -rf .venv .venv-* build install log .mypy_cache .ruff_cache .pytest_cache
