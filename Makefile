# Everything a fresh machine needs is Python 3.11 to 3.13 with its venv module, and make.
# `make demo` and `make test` set up .venv by themselves; the second run goes straight to work.

PYTHON ?= python3
VENV ?= .venv
UV_VERSION := 0.13.8

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.ONESHELL:
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help
MAKEFLAGS += --no-builtin-rules --no-print-directory

unexport PYTHONPATH PYTHONHOME
# numba keys compiled code by one file's time stamp; code that a kernel calls from another file is covered by this name.
export NUMBA_CACHE_DIR = $(abspath $(VENV))/numba/$(shell cat host_sync/*/*.py | cksum | cut -d ' ' -f 1)
export PIP_USER = 0
export PIP_REQUIRE_VIRTUALENV = 0
export PIP_DISABLE_PIP_VERSION_CHECK = 1

.PHONY: help demo test powercut format lock clean set-up

help: ## say what there is
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-8s %s\n", $$1, $$2 }' Makefile

demo: set-up ## the whole story on the simulated handheld; pictures in demo-output/
	@"$(VENV)/bin/python" docs/demo/story.py --out demo-output

test: set-up ## the one gate: lint, types, import contracts, tests
	@"$(VENV)/bin/python" -m pytest

powercut: set-up ## a thousand power cuts on a recorded ext4 (wants root and qemu-storage-daemon)
	@"$(VENV)/bin/python" -m pytest -m "slow or not slow" -rs tests/device/test_power_cut.py

format: set-up ## put the code into the house's form
	@"$(VENV)/bin/ruff" format
	"$(VENV)/bin/ruff" check --fix

lock: ## choose the newest versions that pyproject.toml allows and pin them (wants the network)
	@bash .ci/set-up check "$(PYTHON)"
	"$(PYTHON)" -m venv --clear .lock-tool
	trap 'rm -rf .lock-tool' EXIT
	.lock-tool/bin/python -m pip install --quiet "uv==$(UV_VERSION)"
	UV_CUSTOM_COMPILE_COMMAND='make lock' .lock-tool/bin/uv pip compile --quiet --upgrade --universal --fork-strategy fewest --python-version 3.11 \
	    --generate-hashes --no-emit-index-url --no-emit-find-links \
	    --extra device --extra host --extra dev --output-file requirements.lock pyproject.toml

clean: ## remove .venv, demo-output and every cache
	@rm -rf .venv .lock-tool demo-output dist .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
	find hal device host_sync tests docs -name __pycache__ -type d -prune -exec rm -rf {} +

set-up:
	@bash .ci/set-up "$(PYTHON)" "$(VENV)"
