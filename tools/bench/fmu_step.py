"""What one step of the plant costs, and what an importer adds to it.

``python -m tools.bench.fmu_step`` steps the shipped FMUs of both FMI versions by 1 ms, with four inputs set and the
outputs read, in four ways: a C loop over the FMU's functions (the floor), the bridge's importer as the firmware calls
it, the importer called from Python for every step, and FMPy's class methods with lists, as its tutorial has them. All
ways run in turn, again and again; the numbers are medians of CPU time. Then it prints what the plant itself costs with
each contact and drive. Needs a C compiler.
"""

import argparse
import contextlib
import json
import statistics
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cffi
from rich.console import Console
from rich.table import Table

import plant_fmu
from firmware_protocol.built import SUFFIX, BuildError
from hil.core.errors import HilError
from hil.core.plant_signals import COUNTS, DUTIES, ENABLED, INPUTS, OUTPUTS, POSE, SPEEDS, TORQUES
from hil.core.types import Wheels
from hil.plant import shim
from hil.plant.fmu import FmuPlant
from hil.plant.mapping import SignalMap, resolve
from hil.plant.start import Value
from tools.build.compiler import compile_shared

HERE = Path(__file__).parent
TORQUE = Wheels(0.1, -0.1, 0.05, 0.02)
TWELVE = (*POSE, *SPEEDS, *COUNTS, "gyro.z_rad_s")
ALL = OUTPUTS[:21]  # those that the bridge reads of a plant that has them all
ON = dict.fromkeys(ENABLED, 1.0)
BY_TORQUE = dict(zip(TORQUES, TORQUE, strict=True)) | ON
BY_DUTY = dict(zip(DUTIES, TORQUE, strict=True)) | ON
EVERY = dict.fromkeys(INPUTS, 0.0) | BY_TORQUE  # as the importer sets them
CASES: dict[str, tuple[Mapping[str, Value], Mapping[str, float]]] = {  # start values, and the inputs that are set
    "rigid contact, torque": ({"contact": "rigid", "drive": "torque"}, BY_TORQUE),
    "rigid contact, current": ({"contact": "rigid", "drive": "current"}, BY_TORQUE),
    "rigid contact, voltage": ({"contact": "rigid", "drive": "voltage"}, BY_DUTY),
    "slip contact, torque": ({"contact": "slip", "drive": "torque"}, BY_TORQUE),
    "slip contact, voltage": ({"contact": "slip", "drive": "voltage"}, BY_DUTY),
}


class Way(NamedTuple):
    """One way to step: ``run`` takes so many steps of an instance at its start."""

    name: str
    plant: FmuPlant
    run: Callable[[int], None]


class RawLoop:
    """The C loop of raw_loop.c, compiled here."""

    def __init__(self, folder: Path) -> None:
        library = folder / f"raw_loop{SUFFIX}"
        compile_shared([HERE / "raw_loop.c"], library, include=[HERE])
        self._ffi = cffi.FFI()
        header = (HERE / "raw_loop.h").read_text(encoding="utf-8")
        self._ffi.cdef(header.partition("/* cffi: begin */")[2].partition("/* cffi: end */")[0])
        self._library: Any = self._ffi.dlopen(str(library))

    def way(
        self, name: str, plant: FmuPlant, inputs: Mapping[str, float], outputs: Sequence[str], step_ms: int = 1
    ) -> Way:
        """Return the loop over an instance that sets these inputs and reads these outputs."""
        instance = plant.instance
        loop: Any = self._ffi.new("raw_loop *", {"fmi_version": instance.version, "step_ms": step_ms})
        loop.component = self._ffi.cast("void *", instance.fmu.component)
        real, integer = ("Real", "Integer") if instance.version == 2 else ("Float64", "Int32")
        loop.set_real = self._function(instance.access("Set", real))
        loop.get_real = self._function(instance.access("Get", real))
        loop.get_integer = self._function(instance.access("Get", integer))
        loop.do_step = self._function(plant.context.do_step)
        reals, integers = references_of(plant, outputs)
        loop.input = [instance.variables[name].valueReference for name in inputs]
        loop.value, loop.inputs = list(inputs.values()), len(inputs)
        loop.real, loop.reals = reals, len(reals)
        loop.integer, loop.integers = integers, len(integers)

        def run(steps: int) -> None:
            if self._library.raw_run(loop, steps) != 0:
                raise SystemExit(f"the FMU failed in the C loop: {plant.message}")

        return Way(name, plant, run)

    def _function(self, function: Any) -> Any:
        address = int(shim.load()[0].cast("uintptr_t", function))
        return self._ffi.cast("raw_function", address)


def references_of(plant: FmuPlant, outputs: Sequence[str]) -> tuple[list[int], list[int]]:
    """Return the value references of these outputs: real ones, whole ones."""
    variables = [plant.instance.variables[name] for name in outputs]
    whole = [v.valueReference for v in variables if v.type in ("Integer", "Int32")]
    return [v.valueReference for v in variables if v.valueReference not in whole], whole


def importer(plant: FmuPlant, fmu: Path, outputs: Sequence[str]) -> Way:
    """Return the bridge's importer, reading no more than these outputs, stepped as the firmware steps it."""
    wiring = resolve(SignalMap(), fmu, plant.instance.variables, plant.instance.units)
    chosen = tuple(c for c in wiring.outputs if OUTPUTS[c.signal] in outputs)
    memory = shim.connect(plant.context, wiring._replace(outputs=chosen, derived=frozenset()), plant.instance.access)

    def run(steps: int) -> None:
        assert memory, "the shim uses it"
        plant.step(TORQUE, steps)

    return Way("hil, one C call a tick", plant, run)


def importer_from_python(plant: FmuPlant) -> Way:
    """Return the bridge's importer, called from Python for every step, with what Python reads of it."""

    def run(steps: int) -> None:
        for _ in range(steps):
            plant.step(TORQUE)
            plant.truth()
            plant.wheel_speeds()

    return Way("hil, from Python step by step", plant, run)


def fmpy_methods(plant: FmuPlant, outputs: Sequence[str]) -> Way:
    """Return FMPy's own class over an instance, with lists."""
    fmu = plant.instance.fmu
    two = plant.instance.version == 2
    set_real, get_real = (fmu.setReal, fmu.getReal) if two else (fmu.setFloat64, fmu.getFloat64)
    get_integer = fmu.getInteger if two else fmu.getInt32
    inputs = [plant.instance.variables[name].valueReference for name in EVERY]
    reals, integers = references_of(plant, outputs)
    values = list(EVERY.values())

    def run(steps: int) -> None:
        for n in range(steps):
            set_real(inputs, values)
            fmu.doStep(n * 1_000_000 / 1e9, 1e-3)
            get_real(reals)
            get_integer(integers)

    return Way("FMPy's class methods", plant, run)


def microseconds(ways: Sequence[Way], steps: Sequence[int], repeats: int) -> list[list[float]]:
    """Return the CPU time of a step [us] of each way, once for each repeat; the ways take turns."""
    times: list[list[float]] = [[] for _ in ways]
    for _ in range(repeats):
        for way, count, kept in zip(ways, steps, times, strict=True):
            way.plant.reset()
            begin = time.process_time_ns()
            way.run(count)
            kept.append((time.process_time_ns() - begin) / 1000 / count)
    return times


def compare(
    raw: RawLoop, fmu: Path, outputs: Sequence[str], repeats: int, figures: dict[str, dict[str, float]]
) -> Table:
    """Measure all ways over one FMU, each with an instance of its own; what each adds goes into ``figures`` too."""
    with contextlib.ExitStack() as opened:
        new = [opened.enter_context(FmuPlant(fmu, {})) for _ in range(4)]
        ways = [
            raw.way("C loop over the FMU", new[0], EVERY, outputs),
            importer(new[1], fmu, outputs),
            importer_from_python(new[2]),
            fmpy_methods(new[3], outputs),
        ]
        floor, *others = microseconds(ways, (20_000, 20_000, 2_000, 1_000), repeats)
        version = new[0].instance.version
    # The cost of a way is taken within a repeat, so that a slow moment of the machine counts on both sides.
    added = [statistics.median(map(float.__sub__, times, floor)) for times in others]
    title = f"FMI {version}, {len(outputs)} outputs read"
    figures[title] = {way.name: more / added[-1] for way, more in zip(ways[1:], added, strict=True)}
    table = Table("way", "us a step", "added", "of what FMPy adds", title=title)
    table.add_row(ways[0].name, f"{statistics.median(floor):.3f}", "", "")
    for way, times, more in zip(ways[1:], others, added, strict=True):
        table.add_row(way.name, f"{statistics.median(times):.3f}", f"{more:.3f}", f"{more / added[-1]:.1%}")
    return table


def plants(raw: RawLoop, fmu: Path, repeats: int) -> Table:
    """Measure what a millisecond of the plant costs with each contact and drive, in the C loop."""
    with contextlib.ExitStack() as opened:
        ways = [
            raw.way(name, opened.enter_context(FmuPlant(fmu, start)), inputs, TWELVE)
            for name, (start, inputs) in CASES.items()
        ]
        times = microseconds(ways, [5_000] * len(ways), repeats)
    table = Table("plant", "us a millisecond of robot time", title="The plant itself, in the C loop")
    for way, cost in zip(ways, times, strict=True):
        table.add_row(way.name, f"{statistics.median(cost):.3f}")
    return table


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="tools.bench.fmu_step", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--repeats", type=int, default=31, help="of every measurement; the median counts")
    parser.add_argument("fmu", nargs="*", type=Path, help="FMUs to step; the shipped ones by default")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    options = parser.parse_args()
    figures: dict[str, dict[str, float]] = {}
    fmus = options.fmu or [plant_fmu.path(fmi) for fmi in (2, 3)]
    console = Console()
    try:
        with tempfile.TemporaryDirectory() as folder:
            raw = RawLoop(Path(folder))
            for fmu in fmus:
                for outputs in (TWELVE, ALL):
                    console.print(compare(raw, fmu, outputs, options.repeats, figures))
            console.print(plants(raw, fmus[0], options.repeats))
    except (BuildError, HilError) as error:
        raise SystemExit(f"tools.bench.fmu_step: {error}") from error
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
