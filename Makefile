# Two commands on a fresh machine: `make demo` and `make test`. Both set up .venv first and need Python 3.11 or newer,
# make and a C compiler.
PYTHON ?= python3
BIN := .venv/bin
NATIVE_SOURCES := $(wildcard firmware_protocol/firmware/*.[ch] firmware_protocol/port/host/*.[ch] \
	firmware_protocol/generated/*.[ch] plant_fmu/*.[ch] plant_fmu/*.toml plant_fmu/generated/* plant_fmu/*.py \
	plant_fmu/documentation/* plant_fmu/documentation/licenses/* hil/plant/*.[ch] hil/plant/build.py \
	firmware_protocol/build.py)

.PHONY: demo test check proof picture format native clean setup

demo: setup
	$(BIN)/hil run paper_circle

test: setup
	$(BIN)/python -m pytest

check: setup
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/clang-format --dry-run -Werror $$(git ls-files '*.c' '*.h')
	$(BIN)/python -m firmware_protocol.generate --check
	$(BIN)/python -m plant_fmu.generate --check

# What the tests of the firmware are worth: lines run, and wrong checks noticed. All of it: tools.mutate without
# --sample, and tools.fuzz --runs 10000000.
proof: setup
	$(BIN)/python -m tools.coverage_firmware
	$(BIN)/python -m tools.mutate --sample 20

picture: setup
	$(BIN)/hil run paper_circle --record runs/picture.rrd
	$(BIN)/python tools/screenshot.py runs/picture.rrd tools/pictures/paper_circle.png

format: setup
	$(BIN)/ruff check --fix
	$(BIN)/ruff format
	$(BIN)/clang-format -i $$(git ls-files '*.c' '*.h')

setup: .venv/installed native

.venv/installed: pyproject.toml tools/hatch_build.py
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed; set PYTHON")'
	@$(PYTHON) -c 'import ensurepip, venv' || { echo "Python's venv is missing; on Debian: apt install python3-venv"; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

native: .venv/native

.venv/native: .venv/installed $(NATIVE_SOURCES)
	$(BIN)/python -m firmware_protocol.build
	$(BIN)/python -m plant_fmu.build
	$(BIN)/python -m hil.plant.build
	@touch $@

clean:
	rm -rf .venv build dist runs
	rm -f plant_fmu/*.fmu $(foreach s,so dylib dll,firmware_protocol/*.$(s) hil/plant/*.$(s))
