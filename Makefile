# One command each, from a fresh clone. Needs Python 3.11 or 3.12 and a C++ compiler; ROS 2 Jazzy and
# everything else comes from PyPI into .venv/. With a ROS installation, colcon does this job instead.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help

# Used when .venv is made; to change it later, `make clean` first.
PYTHON ?= python3
VENV := .venv
EXTRAS := ros,interfaces,sim,report,view,rigid-body,compare,sweep,test,dev,docs

# The environment is whole and stands on its own. What a sourced ROS or another environment exports
# would put other versions of the same libraries in front of it.
unexport AMENT_CURRENT_PREFIX AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH PKG_CONFIG_PATH
unexport PYTHONHOME PYTHONPATH RMW_IMPLEMENTATION ROS_DISTRO ROS_PYTHON_VERSION ROS_VERSION
ifneq ($(AMENT_PREFIX_PATH)$(_ROS_WHEELS_BOOTSTRAP_COMPLETE),)
unexport LD_LIBRARY_PATH
endif
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE

# The ROS wheels restart every Python that starts, to extend LD_LIBRARY_PATH, unless this is set. pip
# and the compilers that it calls are better off without.
PIP := _ROS_WHEELS_BOOTSTRAP_COMPLETE=1 $(VENV)/bin/python -m pip

# Each step leaves a stamp inside the environment when it has come to its end, so that a step that
# failed or was interrupted is done again, and a new environment starts from the first.
CREATED := $(VENV)/.created
PACKAGES := $(VENV)/.packages
INTERFACES := $(VENV)/.interfaces
INTERFACE_FILES := $(shell find interfaces -type f)

.PHONY: help setup demo test check docs dist constraints clean

help:  ## this list
	@sed -n 's/^\([a-z]*\):.*## /  make \1\t/p' Makefile | expand -t 20

# Locked, because two terminals may ask at the same time: the second waits and finds the work done.
setup:  ## prepare .venv: ROS 2 Jazzy, the interfaces, tel_ros itself
	@flock Makefile $(MAKE) --silent --no-print-directory $(INTERFACES)

demo: setup  ## the simulated arm practises until it is fast, then as fast as it can
	$(VENV)/bin/tel practice config/planar_arm.yaml
	@echo "As fast as the arm can:"
	$(VENV)/bin/tel practice config/fastest.yaml

# Every stage runs, whatever fails before it, and the end says what failed. Graphs wait for each other's messages
# now and then: three at a time keep two cores busy, and files stay together because their tests share graphs.
# Tests marked `realtime`, all of them in these two folders, measure it: they run last and alone, and one that fails
# is run once more, which the closing line counts.
test: setup  ## all tests
	@failed=(); \
	stage() { echo "== $$1"; $(VENV)/bin/python -m pytest "$${@:2}" || failed+=("$$1"); }; \
	stage "without a graph" --cache-clear -n 2 --dist worksteal -m "not realtime" --ignore=test/graph \
		--ignore=test/contract --ignore=test/faults/test_campaign.py; \
	stage "graphs of nodes" -n 3 --dist loadfile --no-loadscope-reorder -m "not realtime" \
		test/faults/test_campaign.py test/graph test/contract; \
	stage "in real time" -m realtime --reruns 1 -r fER test/graph test/contract; \
	if (( $${#failed[@]} )); then \
		printf 'FAILED: tests %s\n' "$${failed[@]}"; \
		$(VENV)/bin/python -c 'import json; print(*json.load(open(".pytest_cache/v/cache/lastfailed")), sep="\n")'; \
		exit 1; \
	fi

check: setup  ## linters and types
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy

# The variable silences what the theme says about the successors of mkdocs, which is no warning about our pages.
docs: setup  ## the documentation site, into site/
	NO_MKDOCS_2_WARNING=1 $(VENV)/bin/python -m mkdocs build --strict

dist: setup  ## wheels and source distribution, into dist/
	rm -rf dist
	$(VENV)/bin/python -m build --no-isolation --outdir dist .
	$(VENV)/bin/python tools/interfaces_wheel.py dist

# An environment names its folder in many places: one that was copied or moved is made anew.
ifneq ($(shell test -x $(VENV)/bin/python && cat $(CREATED) 2>/dev/null),$(CURDIR))
.PHONY: $(CREATED)
endif
$(CREATED):
	@tools/create_venv.sh "$(PYTHON)" $(VENV)
	@echo "$(CURDIR)" > $@

# Where there is no wheel (PyBullet on Python 3.12) pip builds from source. Without build isolation it
# builds with the pinned tools, and PyBullet finds the NumPy that it will be used with.
$(PACKAGES): $(CREATED) setup.py constraints.txt
	@echo "Installing packages into $(VENV): a minute or two; on Python 3.12, where PyBullet is compiled, about ten"
	@$(PIP) install --quiet --constraint constraints.txt setuptools wheel numpy
	@$(PIP) install --quiet --constraint constraints.txt --no-build-isolation --editable '.[$(EXTRAS)]'
	@touch $@

BUILD_FILES := tools/build_interfaces.sh tools/wheel_include_paths.cmake
$(INTERFACES): $(CREATED) constraints.txt $(INTERFACE_FILES) $(BUILD_FILES) | $(PACKAGES)
	@echo "Building tel_interfaces and control_msgs: about two minutes"
	@tools/build_interfaces.sh $(VENV)
	@touch $@

constraints:  ## the newest versions of everything, into constraints.txt
	$(PYTHON) tools/refresh_constraints.py $(EXTRAS)

clean:  ## remove everything that was built, but no bags
	rm -rf $(VENV) build dist site install log .pytest_cache .mypy_cache .ruff_cache *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
