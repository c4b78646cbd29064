# Everything a fresh machine needs is Python 3.11 to 3.13 with its venv module, and make.
# `make demo` and `make test` set up .venv by themselves; the second run goes straight to work.

PYTHON ?= python3
VENV ?= .venv
# What `make system-test` boots: Debian root, kernel and disk, kept between runs; 3 GB, 5 while it is made.
SYSTEM_CACHE ?= $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/retrograph-system
# What `make image` keeps between builds: Debian for arm64 and the wheels; 1 GB, 3 while it is at work.
IMAGE_CACHE ?= $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/retrograph-image
# Of the housing; and where `make step` keeps Open CASCADE's Python binding, 400 MB.
EVERY_PART := body led_holder gel_frame camera_plate tray saddle panel_frame panel_post panel_clip cap plate block
STEP_TOOL ?= .step-tool

# Of the tests; each takes up to 3 GB. The third works while others wait for screens, files and programs.
PROCESSES ?= 3

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.ONESHELL:
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help
MAKEFLAGS += --no-builtin-rules --no-print-directory

# Compiled modules are kept: tests start hundreds of programs.
unexport PYTHONPATH PYTHONHOME PYTHONDONTWRITEBYTECODE
export PIP_USER = 0
export PIP_REQUIRE_VIRTUALENV = 0
export PIP_DISABLE_PIP_VERSION_CHECK = 1

.PHONY: help demo accuracy methods test test-all test-changed test-deps powercut fuzz system-root system-test system-image image-test image bench format board board-test parts step docs release lock audit clean set-up

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-9s %s\n", $$1, $$2 }' Makefile

# One thread for linear algebra, as the command lines have it: waiting threads take three times the processor time.
demo accuracy methods test test-all test-changed: export OPENBLAS_NUM_THREADS ?= 1
# Temporary files in memory, where there are 4 GB of it that may hold programs: many tests wait for every file to be on disk.
test test-all test-changed: export TMPDIR := $(shell bash .ci/temporary-folder)

demo: set-up ## the whole workflow on the simulated handheld; pictures in demo-output/
	@"$(VENV)/bin/python" -m tests.demo.story --out demo-output

accuracy: set-up ## every accuracy figure against its limit, on the twin and, where present, on real frames; writes accuracy.json
	@"$(VENV)/bin/python" -m tests.benchmarks.accuracy.accuracy $(ARGS)

methods: set-up ## compare the paper's method with the direct one; rewrites the table of docs/paper.md
	@"$(VENV)/bin/python" -m tests.benchmarks.accuracy.methods $(ARGS)

# Of tests that may take longer than the limit in pyproject.toml.
UNLIMITED := -o faulthandler_timeout=0

TESTS = "$(VENV)/bin/python" -m pytest -n $(PROCESSES) --dist loadfile --no-loadscope-reorder --durations=25

# The state of the files in which all tests passed or were skipped; `.venv` is new after a change of the lock or of Python.
PASSED := $(VENV)/instrument-passed

test: set-up ## the gate: lint, types, contracts, tests of every promise; the handheld's if what they reach changed (ALL=1: all)
	@$(if $(ALL),rm -f "$(PASSED)")
	state=$$("$(VENV)/bin/python" -m tests.instrument_passed state)
	left_out=$$("$(VENV)/bin/python" -m tests.instrument_passed options "$(PASSED)" "$$state")
	$(TESTS) $$left_out
	"$(VENV)/bin/python" -m tests.instrument_passed passed "$(PASSED)" "$$state"

test-all: set-up ## the gate, and every long test (see tests/tiers.toml; hours)
	@$(TESTS) $(UNLIMITED) -m "not board and not system"

test-changed: set-up ## the long tests of parts that changed since BASE=COMMIT (by default the main branch, or the previous commit)
	@"$(VENV)/bin/python" -m tests.tiers $(BASE)

powercut: set-up ## a thousand power cuts on a recorded ext4, and every call into the system failing once (needs root, qemu-storage-daemon, gcc)
	@"$(VENV)/bin/python" -m pytest $(UNLIMITED) -m "slow or not slow" -rs tests/device/store/test_power_cut.py tests/host_sync/offload/test_io_faults.py

fuzz: set-up ## a hundred thousand mutated inputs; then two minutes guided by coverage, where atheris is installed
	@"$(VENV)/bin/python" -m pytest $(UNLIMITED) -m "slow or not slow" -rs tests/host_sync/test_mutations.py
	if "$(VENV)/bin/python" -c 'import atheris' 2>/dev/null; then
	    "$(VENV)/bin/python" -m tests.fuzz.records 120
	else
	    printf 'atheris is not installed (x86-64: %s -m pip install "atheris>=3"): nothing was guided by coverage\n' "$(VENV)/bin/python"
	fi

system-root: system-cache ## libcamera's virtual camera under our driver, in a separate Debian (needs root and QEMU)
	@RETROGRAPH_SYSTEM="$(SYSTEM_CACHE)" "$(VENV)/bin/python" -m pytest $(UNLIMITED) -m system --basetemp "$(SYSTEM_CACHE)/run" tests/system/test_virtual_camera.py

system-test: system-cache system-image ## the whole handheld on a virtual board, and the card's image: install, scan, pull, update, power cuts (QEMU)
	@RETROGRAPH_SYSTEM="$(SYSTEM_CACHE)" RETROGRAPH_IMAGE="$(SYSTEM_CACHE)/image" "$(VENV)/bin/python" -m pytest $(UNLIMITED) -m system --basetemp "$(SYSTEM_CACHE)/run" tests/system

image-test: system-image ## the card's image alone, in QEMU's arm64 board: boot, scan with the twin, pull, update of the system
	@RETROGRAPH_IMAGE="$(SYSTEM_CACHE)/image" "$(VENV)/bin/python" -m pytest $(UNLIMITED) -m system -rs --basetemp "$(SYSTEM_CACHE)/run-image" tests/system/test_image.py

# The image that is tested is the twin's, with a key that only the tests have.
system-image: export SOURCE_DATE_EPOCH ?= $(shell git log -1 --format=%ct 2>/dev/null || echo 1735689600)
system-image: release
	@mkdir -p "$(SYSTEM_CACHE)/image"
	[ -e "$(SYSTEM_CACHE)/image/key" ] || ssh-keygen -q -t ed25519 -N '' -C image-test -f "$(SYSTEM_CACHE)/image/key"
	"$(VENV)/bin/python" .ci/image/image_build.py --board twin --cache "$(IMAGE_CACHE)" --output "$(SYSTEM_CACHE)/image/twin.img" \
	    --ssh-key "$(SYSTEM_CACHE)/image/key.pub" --update "$(SYSTEM_CACHE)/image/twin.update"
	bash .ci/seal "$(SYSTEM_CACHE)/image/twin.update"

system-cache: set-up
	@bash tests/system/build "$(SYSTEM_CACHE)" "$(VENV)/bin/python"

# The time that packages and file systems are made at: the commit's, so that it says nothing of the day.
image: export SOURCE_DATE_EPOCH ?= $(shell git log -1 --format=%ct 2>/dev/null || echo 1735689600)
image: release ## a card's image in dist/image/BOARD.img (BOARD=...; see docs/image.md; needs root)
	@"$(VENV)/bin/python" .ci/image/image_build.py --board "$(BOARD)" --cache "$(IMAGE_CACHE)" --output "dist/image/$(BOARD).img" \
	    --install "$(INSTALL)" --snapshot "$(SNAPSHOT)" $(if $(SSH_KEY),--ssh-key "$(SSH_KEY)") $(if $(NETWORK),--network "$(NETWORK)") \
	    $(if $(SOURCES),--sources "$(SOURCES)") $(if $(UPDATE),--update "dist/image/$(BOARD).update")
	[ -z "$(UPDATE)" ] || bash .ci/seal "dist/image/$(BOARD).update" $(if $(KEY),"$(abspath $(KEY))")

test-deps: ## install what every test needs on Debian: a mocked I2C bus, a browser, sshd, disks that lose power, dtc, openscad (needs root)
	@bash .ci/test-deps all

bench: set-up ## speed next to peer programs; a table and bench.json (QUICK=1: seconds, shows only that everything runs)
	@bash .ci/set-up-bench "$(VENV)"
	PYTHONPATH="$(abspath $(VENV))/peers" "$(VENV)/bin/python" -m tests.benchmarks.speed.run $(if $(QUICK),--quick)

format: set-up ## format the code
	@"$(VENV)/bin/ruff" format
	"$(VENV)/bin/ruff" check --fix

board: set-up ## write the tables and drawings in board/ again, and files for a board house into build/board
	@"$(VENV)/bin/python" -m tests.drawings.board.drawings
	"$(VENV)/bin/python" -m tests.drawings.pcb.make

board-test: set-up ## read the files for a board house back with gerbonara, and check KiCad's rules where that is installed
	@if ! cmp -s requirements-board.lock "$(VENV)/board/made-of"; then
	    rm -rf "$(VENV)/board"
	    "$(VENV)/bin/python" -m pip install --quiet --target "$(VENV)/board" --no-deps --require-hashes --only-binary :all: \
	        -r requirements-board.lock
	    cp requirements-board.lock "$(VENV)/board/made-of"
	fi
	PYTHONPATH="$(abspath $(VENV))/board" "$(VENV)/bin/python" -m pytest -rs tests/board/test_pcb_files.py

parts: ## STL of every part of a housing in dist/parts/BOARD (BOARD=pi5-imx296 or pi4-imx477; minutes; needs openscad)
	@mkdir -p "dist/parts/$(BOARD)"
	for part in $(or $(PARTS),$(EVERY_PART)); do
	    openscad -q -D "part=\"$$part\"" -D 'board="$(BOARD)"' -o "dist/parts/$(BOARD)/$$part.stl" board/enclosure/retrograph.scad
	    echo "dist/parts/$(BOARD)/$$part.stl"
	done

step: ## STEP of every part, next to its STL: exact solids for a machine shop (BOARD, PARTS as above; seconds; needs openscad)
	@if ! cmp -s .ci/step/step.lock "$(STEP_TOOL)/made-of"; then
	    "$(PYTHON)" -m venv --clear "$(STEP_TOOL)"
	    "$(STEP_TOOL)/bin/python" -m pip install --quiet --require-hashes --only-binary :all: -r .ci/step/step.lock
	    cp .ci/step/step.lock "$(STEP_TOOL)/made-of"
	fi
	mkdir -p "dist/parts/$(BOARD)"
	# openscad goes into the source's folder before it writes a .csg: hence the whole path.
	for part in $(or $(PARTS),$(EVERY_PART)); do
	    openscad -q -D "part=\"$$part\"" -D 'board="$(BOARD)"' -o "$(CURDIR)/dist/parts/$(BOARD)/$$part.csg" board/enclosure/retrograph.scad
	    "$(STEP_TOOL)/bin/python" .ci/step/step_write.py "dist/parts/$(BOARD)/$$part.csg"
	    rm "dist/parts/$(BOARD)/$$part.csg"
	done

docs: set-up ## the documents as a site in docs-site/, links checked, with the API reference
	@bash .ci/docs "$(VENV)"

release: set-up ## wheel and sdist in dist/; dist/release for handhelds (wheel, lock, board/, systemd/, SBOM; signed with KEY=...)
	@rm -rf dist/release dist/retrograph-*
	"$(VENV)/bin/python" -m hatchling build -t wheel -t sdist -d dist >/dev/null
	mkdir dist/release
	cp dist/retrograph-*.whl dist/release/
	cp -r requirements-device.lock board systemd dist/release/
	[ -z "$(WHEELS)" ] || cp -r "$(WHEELS)" dist/release/wheels
	"$(VENV)/bin/python" .ci/sbom.py dist/release
	bash .ci/seal dist/release $(if $(KEY),"$(abspath $(KEY))")
	echo "dist/ holds wheel and sdist: pip install \"$$(echo dist/*.whl)[host]\""
	echo "dist/release is ready$(if $(KEY),, and not signed (KEY=...)): copy it to the handheld and run sudo board/install.sh --board NAME there"

lock: ## choose the newest versions that pyproject.toml allows and pin them (needs the network)
	@bash .ci/set-up check "$(PYTHON)"
	"$(PYTHON)" -m venv --clear .lock-tool
	trap 'rm -rf .lock-tool' EXIT
	.lock-tool/bin/python -m pip install --quiet --require-hashes --only-binary :all: -r .ci/uv.lock
	UV_CUSTOM_COMPILE_COMMAND='make lock' .lock-tool/bin/uv pip compile --quiet --upgrade --universal --fork-strategy fewest --python-version 3.11 \
	    --generate-hashes --no-emit-index-url --no-emit-find-links \
	    --extra device --extra host --extra dev --output-file requirements.lock pyproject.toml
	UV_CUSTOM_COMPILE_COMMAND='make lock' .lock-tool/bin/uv pip compile --quiet --universal --fork-strategy fewest --python-version 3.11 \
	    --generate-hashes --no-emit-index-url --no-emit-find-links --constraint requirements.lock \
	    --extra device --extra pi --output-file requirements-device.lock pyproject.toml
	UV_CUSTOM_COMPILE_COMMAND='make lock' .lock-tool/bin/uv pip compile --quiet --upgrade --universal --fork-strategy fewest --python-version 3.11 \
	    --generate-hashes --no-emit-index-url --no-emit-find-links --constraint requirements.lock \
	    $$(sed -n 's/^\([a-z0-9._-]*\)==.*/--no-emit-package \1/p' requirements.lock) \
	    --extra bench --extra cluster --output-file requirements-bench.lock pyproject.toml
	UV_CUSTOM_COMPILE_COMMAND='make lock' .lock-tool/bin/uv pip compile --quiet --upgrade --universal --fork-strategy fewest --python-version 3.11 \
	    --generate-hashes --no-emit-index-url --no-emit-find-links --constraint requirements.lock \
	    $$(sed -n 's/^\([a-z0-9._-]*\)==[^;]*$$/--no-emit-package \1/p' requirements.lock) \
	    --extra docs --output-file requirements-docs.lock pyproject.toml
	UV_CUSTOM_COMPILE_COMMAND='make lock' .lock-tool/bin/uv pip compile --quiet --upgrade --universal --fork-strategy fewest --python-version 3.11 \
	    --generate-hashes --no-emit-index-url --no-emit-find-links --constraint requirements.lock \
	    $$(sed -n 's/^\([a-z0-9._-]*\)==[^;]*$$/--no-emit-package \1/p' requirements.lock) \
	    --extra board --output-file requirements-board.lock pyproject.toml
	UV_CUSTOM_COMPILE_COMMAND='make lock' .lock-tool/bin/uv pip compile --quiet --upgrade --universal --python-version 3.11 \
	    --generate-hashes --no-emit-index-url --no-emit-find-links --output-file .ci/audit.lock - <<<pip-audit

audit: ## look for known faults of locked packages (needs the network; without it nothing is audited)
	@bash .ci/audit "$(PYTHON)"

clean: ## remove .venv, demo-output and every cache
	@rm -rf .venv .lock-tool demo-output docs-site accuracy.json dist .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
	find hal device host_sync tests docs -name __pycache__ -type d -prune -exec rm -rf {} +

set-up:
	@bash .ci/set-up "$(PYTHON)" "$(VENV)"
