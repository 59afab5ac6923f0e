# Two commands do everything on a fresh machine: `make demo` and `make test`.
SHELL := /bin/bash
VENV ?= .venv
PY := $(VENV)/bin/python
PIP := $(PY) -m pip --disable-pip-version-check
export PIP_NO_WARN_SCRIPT_LOCATION := 1
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
	$(MAKE) VENV=.venv-lowest CONSTRAINTS=requirements-lowest.txt unit

setup: $(VENV)/.ready
setup-dev: $(VENV)/.ready-dev

$(VENV)/bin/python:
	@python=$$(tools/find_python) && echo "Making $(VENV) with $$python" && "$$python" -m venv $(VENV)

$(VENV)/.ready: requirements.txt requirements-ros.txt setup.py package.xml $(CONSTRAINTS) | $(VENV)/bin/python
	@echo "Installing ROS 2 Jazzy and what else is needed from PyPI (a minute or two) ..."
	@$(PIP) install -q -r requirements.txt -r requirements-ros.txt $(if $(CONSTRAINTS),-c $(CONSTRAINTS)) 'setuptools<80' 2> >(grep -v 'is ignored: it is neither' >&2)
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
	rm -rf .venv .venv-lowest build install log .mypy_cache .ruff_cache .pytest_cache
