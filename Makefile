# Two commands on a fresh machine: `make demo` and `make test`. Both set up .venv first and need Python 3.11 or newer
# and make. Without a C compiler they are set up with zig. The tests want more than a user needs: .venv/for-tests.
PYTHON ?= python3
BIN := .venv/bin
NATIVE_SOURCES := $(wildcard tools/build/*.py firmware_protocol/built.py firmware_protocol/firmware/*.[ch] \
	firmware_protocol/client/*.[ch] firmware_protocol/port/host/*.[ch] firmware_protocol/port/python/*.[ch] firmware_protocol/generated/*.[ch] plant_fmu/*.[ch] plant_fmu/*.py \
	plant_fmu/*.toml plant_fmu/generated/*.* plant_fmu/generated/*/* plant_fmu/documentation/*.* \
	plant_fmu/documentation/licenses/* plant_fmu/reference/* hil/plant/*.[ch] hil/plant/built.py)

# Python keeps what it has compiled: else every process of the tests would compile all modules again.
export PYTHONDONTWRITEBYTECODE :=
PYTEST := $(BIN)/python -m pytest
BESIDE := --numprocesses auto --maxprocesses 8 --dist worksteal
# Tests of real time mostly wait: three at once disturb each other little.
PAIRWISE := --numprocesses 3 --dist worksteal
ALONE_TESTS := $(shell grep -rl --include='test_*.py' 'pytest\.mark\.alone' tests)
SOCKETCAN_TESTS := $(wildcard tests/*/test_socketcan_*.py)

.PHONY: help demo test test-rest test-all test-socketcan catalogue check proof chaos without bench nightly docs picture format native fmu release ros clean setup

## what make can do here
help:
	@awk '/^## / { text = substr($$0, 4); next } \
		/^[a-z-]+:/ && text { printf "make %-16s %s\n", substr($$1, 1, length($$1) - 1), text } { text = "" }' $(firstword $(MAKEFILE_LIST))

## run the paper's circle on the virtual robot and record it
demo: setup
	$(BIN)/hil run paper_circle

## run the tests that prove most, in under three minutes
test: setup .venv/for-tests
	$(PYTEST) $(BESIDE) -m 'not slow and not alone' $(ARGS)

## run the tests that make test leaves out: the slow ones, and those of real time
test-rest: setup .venv/for-tests
	$(PYTEST) $(BESIDE) -m 'slow and not alone' $(ARGS)
	$(REAL_TIME)

## run all tests, each once
test-all: setup .venv/for-tests
	$(PYTEST) $(BESIDE) -m 'not alone' --durations 15 --durations-min 8 $(ARGS)
	$(REAL_TIME)

# Real time comes after all else, and SocketCAN, whose kernel is a process that needs a processor, by itself.
define REAL_TIME
$(PYTEST) $(PAIRWISE) -m 'alone and not socketcan' $(ALONE_TESTS) $(ARGS)
$(PYTEST) -m socketcan $(SOCKETCAN_TESTS) $(ARGS)
endef

# For example: make test-socketcan ARGS='-k lockstep -v'. Where there is no SocketCAN it says so and fails at once.
## run only the tests over real SocketCAN, which test-rest runs too
test-socketcan: setup .venv/for-tests
	$(BIN)/python -m tools.socketcan true
	$(PYTEST) -m socketcan -rs $(SOCKETCAN_TESTS) $(ARGS)

# Every fault alone over each link, PAIRS of them together, and a part in real time, then over motors of two other makers;
# ARGS goes to hil catalogue. make nightly takes all pairs.
PAIRS ?= --pairs --sample 60
ENDPOINTS = --set 'device.motors.watchdog_endpoints=[419, 420]' --set device.motors.endpoints_firmware=0.6.11 \
	--set device.motors.endpoints_hardware=4.4.58
## put every kind of fault into a run and judge the robot's safety
catalogue: setup
	$(BIN)/hil catalogue $(PAIRS) --realtime $(ARGS)
	$(BIN)/hil catalogue --set loop.rate_hz=200 --set device.driver=moteus $(ARGS)
	$(BIN)/hil catalogue --set loop.rate_hz=200 --set device.driver=odrive $(ENDPOINTS) $(ARGS)

## check style, types, imports, and that what is generated is fresh
check: setup .venv/for-tests
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/clang-format --dry-run -Werror $$(git ls-files '*.c' '*.h')
	$(BIN)/python -m firmware_protocol.generate --check
	$(BIN)/python -m plant_fmu.generate --check
	$(BIN)/python -m plant_fmu.reference --check
	$(BIN)/python -m tools.rules --check
	$(BIN)/python -m tools.unquoted --check

# Lines run, and wrong checks noticed, of which make nightly tries all.
## show what the tests of the C are worth, and of the Python changed last
proof: setup .venv/for-tests
	$(BIN)/python -m tools.coverage_firmware
	$(BIN)/python -m tools.mutate --sample 12 $(foreach file,states receive supervise node,--file $(file).c)
	$(BIN)/python -m tools.mutate --sample 14 --within 45 --near --jobs 1
	$(BIN)/python -m tools.mutate_python --since HEAD~8 --within 45 --near --jobs 1

# CHAOS goes to tools.chaos. Seldom busy for long, so that it can go on beside other things.
CHAOS ?= --minutes 2
## kill, stop and starve a service and its robot at random, and judge by the robot's truth
chaos: setup .venv/for-tests
	$(BIN)/python -m tools.chaos $(CHAOS)

# WITHOUT goes to tools.without_addon. One processor for a minute for each add-on; make nightly runs all tests of the core.
WITHOUT ?= --quick
## remove each add-on in turn and run the demo and quick tests of the core
without: setup .venv/for-tests
	$(BIN)/python -m tools.without_addon $(WITHOUT)

# ARGS goes to tools.bench, as in make bench ARGS=--short.
## measure what a run costs, against named peers
bench: setup .venv/for-tests
	$(BIN)/python -m tools.bench $(ARGS)

# ARGS goes to tools.nightly, as in make nightly ARGS='--only soak'. Takes hours.
## run what is too long for CI, and write its results into one folder
nightly: setup .venv/for-tests
	$(BIN)/python -m tools.nightly $(ARGS)

# Docs are Markdown beside what they describe; the reference is made from the code. A broken link fails.
## write the documentation site into build/docs
docs: setup .venv/for-tests
	$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going -c docs . build/docs $(ARGS)

## draw the pictures of the README, of a recording and of a review's page anew
picture: setup .venv/for-tests
	@mkdir -p runs
	$(BIN)/hil run paper_circle --record runs/picture.rrd --force
	$(BIN)/python -m tools.screenshot runs/picture.rrd tools/pictures/paper_circle.png --at 0.5
	$(BIN)/python -m tools.screenshot runs/picture.rrd tools/pictures/paper_circle_law.png --tab Law
	$(BIN)/python -m tools.screenshot --examples tools/pictures
	$(BIN)/python -m tools.page_pictures tools/pictures

## mend what ruff and clang-format can mend
format: .venv/for-tests
	$(BIN)/ruff check --fix
	$(BIN)/ruff format
	$(BIN)/clang-format -i $$(git ls-files '*.c' '*.h')

## set up .venv and build what is native; the others do it by themselves
setup: .venv/installed native

# A target that needs the tools installs them with the rest, which is quicker than one after the other.
TOOLS := [dev,ros2]
test test-rest test-all test-socketcan check proof chaos without bench nightly docs picture format fmu release: EXTRAS := $(TOOLS)

# The pip that comes with Python may be old and slow. Bytecode is made for what is imported, when it is imported.
PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile

.venv/installed: pyproject.toml tools/hatch_build.py
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed; set PYTHON")'
	@$(PYTHON) -c 'import ensurepip, venv' || { echo "Python's venv is missing; on Debian: apt install python3-venv"; exit 1; }
	$(PYTHON) -m venv .venv
	$(PIP_INSTALL) --upgrade pip
	@[ ! -f .venv/tools ] || rm .venv/tools  # an earlier name of .venv/for-tests; a wheel of ROS 2 has a folder there
	$(PIP_INSTALL) --editable '.$(EXTRAS)'
	@touch $@ .venv/native
	@$(if $(EXTRAS),touch .venv/for-tests)

# Packages for tests, checks and the FMUs of all platforms.
.venv/for-tests: .venv/installed
	@[ -e $@ ] && [ ! $< -nt $@ ] || { set -x; $(PIP_INSTALL) --editable '.$(TOOLS)'; }
	@touch $@

native: .venv/native

.venv/native: .venv/installed $(NATIVE_SOURCES)
	$(BIN)/python -m tools.build.wheel_host
	$(BIN)/python -m tools.build.fmu
	$(BIN)/python -m tools.build.cosim
	@touch $@

## build the FMUs to give away, with binaries for all platforms, into dist/
fmu: .venv/for-tests
	$(BIN)/python -m tools.build.fmu --all-platforms --out dist

## make the package for ROS 2, into dist/ros/, for a workspace of colcon
ros: setup
	$(BIN)/python -m tools.build.ros_package

# Wheels for all platforms with zig, which compiles a C library for each at first: some minutes.
## make all that a release gives away, with checksums, into dist/
release: .venv/for-tests
	$(BIN)/python -m tools.release

## remove all that was set up, built or run
clean:
	rm -rf .venv build dist runs
	rm -f plant_fmu/*.fmu $(foreach s,so dylib dll,firmware_protocol/*.$(s) hil/plant/*.$(s))
