# Two commands on a fresh machine: `make demo` and `make test`. Both set up .venv first and need Python 3.11 or newer
# and make. Without a C compiler they are set up with zig. The tests want more than a user needs: .venv/tools.
PYTHON ?= python3
BIN := .venv/bin
NATIVE_SOURCES := $(wildcard tools/build/*.py firmware_protocol/built.py firmware_protocol/firmware/*.[ch] \
	firmware_protocol/port/host/*.[ch] firmware_protocol/generated/*.[ch] plant_fmu/*.[ch] plant_fmu/*.py \
	plant_fmu/*.toml plant_fmu/generated/*.* plant_fmu/generated/*/* plant_fmu/documentation/*.* \
	plant_fmu/documentation/licenses/* plant_fmu/reference/* hil/plant/*.[ch] hil/plant/built.py)

.PHONY: demo test test-socketcan catalogue check proof bench picture format native fmu clean setup

demo: setup
	$(BIN)/hil run paper_circle

# Real time comes last and alone. HIL_EXAMPLES=thorough tries each property with ten times the examples, new ones each time.
test: setup .venv/tools
	$(BIN)/python -m pytest --numprocesses auto --maxprocesses 8 --dist worksteal -m 'not alone'
	$(BIN)/python -m pytest -m alone

# Only the tests over real SocketCAN, which `make test` runs too; for example: make test-socketcan ARGS='-k lockstep -v'
# Where there is none it says so and fails before any test is collected.
test-socketcan: setup .venv/tools
	$(BIN)/python -m tools.socketcan true
	$(BIN)/python -m pytest -m socketcan -rs tests/test_socketcan_*.py $(ARGS)

# Every fault alone over each link, all pairs, and a part in real time, then over motors of two other makers; ARGS goes to
# hil catalogue.
ENDPOINTS = --set 'device.motors.watchdog_endpoints=[419, 420]' --set device.motors.endpoints_firmware=0.6.11 \
	--set device.motors.endpoints_hardware=4.4.58
catalogue: setup
	$(BIN)/hil catalogue --pairs --realtime $(ARGS)
	$(BIN)/hil catalogue --set loop.rate_hz=200 --set device.driver=moteus $(ARGS)
	$(BIN)/hil catalogue --set loop.rate_hz=200 --set device.driver=odrive $(ENDPOINTS) $(ARGS)

check: setup .venv/tools
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/clang-format --dry-run -Werror $$(git ls-files '*.c' '*.h')
	$(BIN)/python -m firmware_protocol.generate --check
	$(BIN)/python -m plant_fmu.generate --check
	$(BIN)/python -m plant_fmu.reference --check
	$(BIN)/python -m hil.faults.page --check
	$(BIN)/python -m hil.batch.reproduction.page --check

# What the tests of the firmware are worth: lines run, and wrong checks noticed. All of it: tools.mutate without
# --sample, and tools.fuzz --runs 10000000.
proof: setup .venv/tools
	$(BIN)/python -m tools.coverage_firmware
	$(BIN)/python -m tools.mutate --sample 20

# What it costs, against named peers; ARGS goes to tools.bench, as in make bench ARGS=--short.
bench: setup .venv/tools
	$(BIN)/python -m tools.bench $(ARGS)

picture: setup .venv/tools
	$(BIN)/hil run paper_circle --record runs/picture.rrd --force
	$(BIN)/python tools/screenshot.py runs/picture.rrd tools/pictures/paper_circle.png --at 0.5
	$(BIN)/python tools/screenshot.py runs/picture.rrd tools/pictures/paper_circle_law.png --tab Law

format: .venv/tools
	$(BIN)/ruff check --fix
	$(BIN)/ruff format
	$(BIN)/clang-format -i $$(git ls-files '*.c' '*.h')

setup: .venv/installed native

.venv/installed: pyproject.toml tools/hatch_build.py
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed; set PYTHON")'
	@$(PYTHON) -c 'import ensurepip, venv' || { echo "Python's venv is missing; on Debian: apt install python3-venv"; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --editable .
	@touch $@ .venv/native

# Packages for tests, checks and the FMUs of all platforms.
.venv/tools: .venv/installed
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[campaign,dev,mujoco,targets,teleop]'
	@touch $@

native: .venv/native

.venv/native: .venv/installed $(NATIVE_SOURCES)
	$(BIN)/python -m tools.build.wheel_host
	$(BIN)/python -m tools.build.fmu
	$(BIN)/python -m tools.build.cosim
	@touch $@

# The FMUs to give away, with binaries for all platforms.
fmu: .venv/tools
	$(BIN)/python -m tools.build.fmu --all-platforms --out dist

clean:
	rm -rf .venv build dist runs
	rm -f plant_fmu/*.fmu $(foreach s,so dylib dll,firmware_protocol/*.$(s) hil/plant/*.$(s))
