"""FMUs that nobody here shaped: own names, units, types and signs; both FMI versions; every failure."""

import math
import struct
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from firmware_protocol.built import FLAGS, SUFFIX
from hil.core.errors import BadInputError, DeviceError
from hil.core.types import WHEEL_NAMES, Wheels
from hil.plant.built import PLANT_PORT
from hil.plant.built import SOURCES as SHIM_SOURCES
from hil.plant.fmu import FmuPlant
from hil.plant.mapping import Row
from hil.plant.window_stepper import WindowStepper
from tests.support.foreign_fmu import FAULTS, SOURCES, Var, foreign_fmu, foreign_map, variables2, variables3
from tools.build.compiler import compile_shared, compiler

TICK_S = 1e-3
RADIUS_M, LEVER_M = 0.1, 0.5
TORQUE = Wheels(0.1, -0.2, 0.3, 0.15)
# FMU wheels 1 to 4 are FL, FR, RL, RR, and the second turns the other way round.
PLACE, SENSE = {"fl": 0, "fr": 1, "rl": 2, "rr": 3}, {"fl": 1, "fr": -1, "rl": 1, "rr": 1}


def single(value: float) -> float:
    return struct.unpack("f", struct.pack("f", value))[0]


def fault(name: str, at_s: float = 0.01) -> dict[str, float]:
    return {"fault": FAULTS.index(name), "fault_time": at_s}


class Robot:
    """The foreign robot in NumPy, in its own order of wheels: exact for torques that are held."""

    def __init__(self, inertia: float = 0.02) -> None:
        self.inertia = inertia
        self.angle = np.zeros(4)
        self.speed = np.zeros(4)

    def hold(self, torque_n_m: Wheels, duration_s: float) -> None:
        torque = np.zeros(4)
        for wheel, value in zip(WHEEL_NAMES, torque_n_m, strict=True):
            torque[PLACE[wheel]] = SENSE[wheel] * single(value)
        a = torque / self.inertia
        self.angle += self.speed * duration_s + a * duration_s**2 / 2
        self.speed += a * duration_s

    def pose(self) -> np.ndarray:
        return pose_of(self.angle)

    def wheels(self, values: np.ndarray) -> list[float]:
        return [SENSE[wheel] * values[PLACE[wheel]] for wheel in WHEEL_NAMES]


def pose_of(angle: np.ndarray) -> np.ndarray:
    signs = np.array([[1, 1, 1, 1], [-1, 1, -1, 1], np.array([-1, 1, 1, -1]) / LEVER_M])
    return RADIUS_M / 4 * signs @ angle


def sense(plant: FmuPlant, torque: Wheels) -> tuple[list[int], list[float], list[float]]:
    """Exchange one tick through the plant port."""
    ffi = plant._ffi
    drive, answer = ffi.new("wheel_drive *"), ffi.new("wheel_sense *")
    drive.torque_n_m = list(torque)
    exchange = ffi.cast("wheel_plant_exchange", plant.exchange_address)
    assert exchange(ffi.cast("void *", plant.context_address), drive, answer) == 0, plant.message
    return list(answer.count), list(answer.current_a), list(answer.gyro_rad_s)


@pytest.mark.parametrize("version", [2, 3])
def test_a_mapped_fmu_moves_as_its_equations_say(version: int, tmp_path: Path) -> None:
    """Half a second of changing torques; the heading passes half a turn, where the FMU wraps it."""
    rng = np.random.default_rng(3)
    robot = Robot()
    with FmuPlant(foreign_fmu(tmp_path, version), {}, mapping=foreign_map(version)) as plant:
        for _ in range(50):
            torque = Wheels(*rng.uniform(-0.5, 0.5, 4) + np.array([-3.0, -3.0, -3.0, 3.0]))
            robot.hold(torque, 9 * TICK_S)
            plant.step(torque, 9)
            before = robot.pose()
            robot.hold(torque, TICK_S)
            counts, currents, gyro = sense(plant, torque)
            fix = plant.truth()
            tolerance = 2e-6  # y is in single precision
            assert np.allclose(fix.pose, robot.pose(), rtol=tolerance, atol=1e-6)
            mean_twist = (robot.pose() - before) / TICK_S
            assert np.allclose(fix.twist, mean_twist, rtol=tolerance, atol=1e-3)
            assert gyro == [0.0, 0.0, single(fix.twist.yaw_rate_rad_s)]
            expected = np.array(robot.wheels(robot.angle)) / math.tau * 1000
            off = np.abs((np.array(counts) - expected + 0x8000) % 0x10000 - 0x8000)
            assert np.all(off <= 1.0 + tolerance * np.abs(expected))
            assert currents == [single(single(t) / 0.5) for t in torque]
        assert abs(robot.pose()[2]) > math.pi, "the heading was never wrapped"
        assert fix.time_ns == 500_000_000


@pytest.mark.parametrize("version", [2, 3])
def test_what_follows_from_the_angles_agrees_with_what_the_fmu_has(version: int, tmp_path: Path) -> None:
    """Counts and speeds as the FMU has them, against those that are made from its angles."""
    numbers = {f"wheel_{w}__count": Row(f"n{PLACE[w] + 1}", sign=SENSE[w]) for w in WHEEL_NAMES}
    speeds = {f"wheel_{w}__speed_rad_s": Row(f"w{PLACE[w] + 1}", sign=SENSE[w]) for w in WHEEL_NAMES}
    fmu = foreign_fmu(tmp_path, version)
    plain = foreign_map(version)
    full = foreign_map(version, **numbers, **speeds)
    with FmuPlant(fmu, {}, mapping=plain) as derived, FmuPlant(fmu, {}, mapping=full) as mapped:
        for _ in range(200):
            one, other = sense(derived, TORQUE), sense(mapped, TORQUE)
            # floor(-x) and -floor(x) differ by one on the wheel that is turned round
            assert all((a - b) % 0x10000 in (0, 1, 0xFFFF) for a, b in zip(one[0], other[0], strict=True))
        assert one[0] != [0] * 4
        half_tick = np.array(TORQUE) / 0.02 * TICK_S / 2
        mean = np.array(mapped.wheel_speeds()) - half_tick
        assert np.allclose(derived.wheel_speeds(), mean, rtol=1e-4)


@pytest.mark.parametrize("version", [2, 3])
def test_a_reset_brings_the_same_run_again(version: int, tmp_path: Path) -> None:
    with FmuPlant(foreign_fmu(tmp_path, version), {"J": 0.03}, mapping=foreign_map(version)) as plant:
        start = plant.truth()
        plant.step(TORQUE, 50)
        first = plant.truth()
        plant.reset()
        assert plant.truth() == start
        plant.step(TORQUE, 50)
        assert plant.truth() == first != start


@pytest.mark.parametrize("version", [2, 3])
def test_start_values_of_every_type_reach_the_fmu(version: int, tmp_path: Path) -> None:
    start: dict[str, float | bool | str] = {"J": 0.06, "gear": "geared", "reversed": True, "label": "a robot"}
    if version == 3:
        start["wheels"] = 6
    with FmuPlant(foreign_fmu(tmp_path, version), start, mapping=foreign_map(version)) as plant:
        plant.step(Wheels(0.1, 0.1, 0.1, 0.1), 100)
        robot = Robot(inertia=0.02)
        robot.hold(Wheels(-0.1, -0.1, -0.1, -0.1), 0.1)
        assert np.allclose(plant.truth().pose, robot.pose(), rtol=1e-4, atol=1e-7)
        assert plant.instance.fmu.getString([50]) == ([b"a robot"] if version == 2 else ["a robot"])


@pytest.mark.parametrize("counter", ["Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"])
def test_a_counter_of_any_integer_type_is_read(counter: str, tmp_path: Path) -> None:
    rows = {f"wheel_{w}__count": Row(f"n{PLACE[w] + 1}") for w in WHEEL_NAMES}
    fmu = foreign_fmu(tmp_path, 3, variables=variables3(counter))
    bits, signed = int(counter.rpartition("Int")[2]), not counter.startswith("U")
    with FmuPlant(fmu, {}, mapping=foreign_map(3, **rows)) as plant:
        robot = Robot()
        for _ in range(100):
            robot.hold(TORQUE, TICK_S)
            counts, _, _ = sense(plant, TORQUE)
        whole = [math.floor(robot.angle[PLACE[w]] / math.tau * 1000) % 2**bits for w in WHEEL_NAMES]
        whole = [n - 2**bits if signed and n >= 2 ** (bits - 1) else n for n in whole]
        assert counts == [(n if bits < 64 or signed or n < 2**63 else n - 2**64) & 0xFFFF for n in whole]


STATUSES = [
    ("say_error", "wheel 1 fell off"),
    ("silent_error", "the FMU failed to step (status 3, error) and did not say why"),
    ("say_discard", "wheel 1 fell off"),
    ("give_nan", "pose.x_m (x in the FMU) is not a number; expected a finite number"),
    ("end", "the FMU asked to end the simulation"),
    ("fail_to_read", "the FMU refused to give its outputs (status 3, error) and did not say why"),
]


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(("name", "words"), STATUSES)
def test_a_failure_says_when_and_why_and_a_reset_mends_it(version: int, name: str, words: str, tmp_path: Path) -> None:
    with FmuPlant(foreign_fmu(tmp_path, version), fault(name), mapping=foreign_map(version)) as plant:
        plant.step(TORQUE, 9)
        good = plant.truth()
        with pytest.raises(DeviceError) as caught:
            plant.step(TORQUE, 5)
        assert words in str(caught.value)
        assert "at 0.009 s" in str(caught.value)
        assert plant.truth() == good
        with pytest.raises(DeviceError, match=r"stopped at 0\.009 s"):
            plant.step(TORQUE)
        plant.reset()
        plant.step(TORQUE, 9)
        assert plant.truth() == good


def test_a_pending_step_is_a_failure(tmp_path: Path) -> None:
    with (
        FmuPlant(foreign_fmu(tmp_path, 2), fault("return_pending"), mapping=foreign_map(2)) as plant,
        pytest.raises(DeviceError, match=r"status 5, pending"),
    ):
        plant.step(TORQUE, 20)


@pytest.mark.parametrize("version", [2, 3])
def test_a_warning_goes_on(version: int, tmp_path: Path) -> None:
    fmu, signals = foreign_fmu(tmp_path, version), foreign_map(version)
    with FmuPlant(fmu, fault("say_warning"), mapping=signals) as warned, FmuPlant(fmu, {}, mapping=signals) as plain:
        warned.step(TORQUE, 20)
        plain.step(TORQUE, 20)
        assert warned.truth() == plain.truth()


@pytest.mark.parametrize("version", [2, 3])
def test_after_a_fatal_status_nothing_of_the_fmu_is_called(version: int, tmp_path: Path) -> None:
    """The FMU aborts this process when it is freed then."""
    with FmuPlant(foreign_fmu(tmp_path, version), fault("say_fatal"), mapping=foreign_map(version)) as plant:
        with pytest.raises(DeviceError, match="wheel 1 fell off"):
            plant.step(TORQUE, 20)
        with pytest.raises(DeviceError, match=r"cannot be reset.*wheel 1 fell off"):
            plant.reset()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("return_early", "the FMU was stepped from 0.01 to 0.011 s and returned early at 0.0105 s"),
        ("reach_elsewhere", "the FMU was stepped from 0.01 to 0.011 s and says that it reached 0.0105 s"),
        ("ask_for_event_mode", "the FMU asked for event mode, which was not agreed on"),
    ],
)
def test_an_fmu_that_does_not_reach_the_end_of_its_step_fails(name: str, words: str, tmp_path: Path) -> None:
    with (
        FmuPlant(foreign_fmu(tmp_path, 3), fault(name), mapping=foreign_map(3)) as plant,
        pytest.raises(DeviceError, match=f"at 0.0{'09' if name.startswith('ask') else '1'} s: {words}"),
    ):
        plant.step(TORQUE, 20)


FIXED = "fixedInternalStepSize"
VARIABLE = {"canHandleVariableCommunicationStepSize": "true"}


def prefers(step: str) -> str:
    return f'<DefaultExperiment stepSize="{step}"/>'


@pytest.mark.parametrize(("version", "size_ms"), [(2, 10.0), (3, 10.0), (2, 3.0), (3, 0.2), (2, 0.125), (2, 1.0)])
def test_an_fmu_is_stepped_by_its_own_size(version: int, size_ms: float, tmp_path: Path) -> None:
    """An FMU that takes no other: the torque that begins a step is held for all of it, and its end shows at its end."""
    fmu = foreign_fmu(tmp_path, version, more=prefers(str(size_ms / 1000)))
    ticks = max(1, round(size_ms))
    rng, robot, told = np.random.default_rng(5), Robot(), Robot().pose()
    with FmuPlant(fmu, {"grain": size_ms / 1000}, mapping=foreign_map(version)) as plant:
        for tick in range(60):
            torque = Wheels(*rng.uniform(-0.5, 0.5, 4))
            if tick % ticks == 0:
                robot.hold(torque, ticks * TICK_S)
            before = told
            if tick % ticks == ticks - 1:
                told = robot.pose()
            sense(plant, torque)
            assert np.allclose(plant.truth().pose, told, rtol=2e-6, atol=1e-9)
            if tick % ticks == ticks - 1:
                speed = (told - before) / (ticks * TICK_S)
                assert np.allclose(plant.truth().twist, speed, rtol=1e-4, atol=1e-6)
            assert plant.truth().time_ns == (tick + 1) * 1_000_000
        if ticks > 1:
            (notice,) = plant.notices
            assert notice.startswith(f"stepped by {size_ms / 1000:g} s, {ticks} ticks")
            assert notice.endswith(f"acts up to {ticks - 1} ms late, and an output is up to {ticks - 1} ms old")


STEPS = [  # version, declaration, plant.step_s, and its step in ms or the text that refuses it; text of a notice
    (2, {}, "", None, 1.0, ""),
    (3, {}, "", None, 1.0, ""),
    (2, {}, prefers("0.001"), None, 1.0, ""),
    (2, {}, prefers("0.0010000000474974513"), None, 1.0, ""),
    (2, {}, prefers("0.01"), None, 10.0, "stepped by 0.01 s, 10 ticks"),
    (2, {}, prefers("0.01"), 0.001, 1.0, "as plant.step_s says; its DefaultExperiment prefers 0.01 s"),
    (2, VARIABLE, prefers("0.01"), None, 1.0, "stepped by the tick of 0.001 s, which it claims to handle"),
    (2, VARIABLE, prefers("0.01"), 0.01, 10.0, "as plant.step_s says"),
    (3, {}, prefers("0.0001"), None, 0.1, "10 times a tick"),
    (3, {}, prefers("0.0015"), None, "communication step is 0.0015 s .*tick 0.001 s; .*set plant.step_s if it", ""),
    (3, {}, prefers("0.5"), None, "communication step is 0.5 s .*tick 0.001 s; .*up to 0.02 s", ""),
    (
        2,
        {},
        prefers("0.0015"),
        None,
        r"is 0\.0015 s \(the stepSize of its DefaultExperiment, since canHandle.* not true",
        "",
    ),
    (2, {}, prefers("1e-9"), None, "communication step is 1e-09 s .*tick 0.001 s", ""),
    (2, {}, prefers("-1"), None, "DefaultExperiment stepSize is '-1'; expected a positive number of seconds$", ""),
    (2, {}, prefers("fast"), None, "DefaultExperiment stepSize is 'fast'; expected a positive number", ""),
    (3, {FIXED: "0.01"}, "", None, 10.0, "for its fixedInternalStepSize"),
    (3, {FIXED: "0.01", **VARIABLE}, prefers("0.001"), None, 10.0, "for its fixedInternalStepSize"),
    (3, {FIXED: "0.0005"}, "", None, 1.0, ""),
    (3, {FIXED: "0.0015"}, "", None, "is 0.0015 s .*fixedInternal.*set plant.step_s if it", ""),
    (3, {FIXED: "0.0015"}, "", 0.003, 3.0, "as plant.step_s says"),
    (
        3,
        {FIXED: "0.01"},
        "",
        0.001,
        "^plant.step_s = 0.001; .*has a fixedInternalStepSize of 0.01 s, expected a whole multiple of that$",
        "",
    ),
    (2, {}, "", 0.0015, "communication step is 0.0015 s .as plant.step_s says", ""),
]


@pytest.mark.parametrize(("version", "declared", "more", "wanted_s", "expected", "words"), STEPS)
def test_what_an_fmu_declares_decides_its_step(
    version: int,
    declared: dict[str, str],
    more: str,
    wanted_s: float | None,
    expected: float | str,
    words: str,
    tmp_path: Path,
) -> None:
    fmu = foreign_fmu(tmp_path, version, more=more, **declared)
    mapping = replace(foreign_map(version), step_s=wanted_s)
    if isinstance(expected, str):
        with pytest.raises(BadInputError, match=expected):
            FmuPlant(fmu, {}, mapping)
    else:
        with FmuPlant(fmu, {"grain": expected / 1000}, mapping) as plant:
            plant.step(TORQUE, 60)
            assert words in "".join(plant.notices)
            assert bool(words) == bool(plant.notices)


@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_that_fails_at_its_start_says_why(version: int, tmp_path: Path) -> None:
    start = fault("fail_at_initialization")
    with pytest.raises(DeviceError, match=r"wheels.\.fmu failed to initialise: wheel 1 fell off"):
        FmuPlant(foreign_fmu(tmp_path, version), start, mapping=foreign_map(version))
    with pytest.raises(BadInputError, match=r"made no instance: wrong"):
        FmuPlant(foreign_fmu(tmp_path, version, guid="{other}"), {}, mapping=foreign_map(version))
    fmu = foreign_fmu(tmp_path, version, guid="{other}", needsExecutionTool="true")
    with pytest.raises(BadInputError, match=r"made no instance, it needs A Tool: wrong"):
        FmuPlant(fmu, {}, mapping=foreign_map(version))
    with pytest.raises(BadInputError, match=r"plant\.start\.label: wheel 1 fell off"):
        FmuPlant(foreign_fmu(tmp_path, version), {"label": "x" * 40}, mapping=foreign_map(version))


def test_an_fmu_that_cannot_reset_says_so(tmp_path: Path) -> None:
    for version in (2, 3):
        start = fault("fail_to_reset")
        with (
            FmuPlant(foreign_fmu(tmp_path, version), start, mapping=foreign_map(version)) as plant,
            pytest.raises(DeviceError, match="failed to reset: wheel 1 fell off"),
        ):
            plant.reset()


@pytest.mark.parametrize(
    ("version", "name", "words"),
    [
        (2, "refuse_to_begin", "failed at its start"),
        (3, "refuse_to_begin", "refused its configuration mode"),
        (3, "stay_in_configuration", "failed to leave its configuration mode"),
    ],
)
def test_an_fmu_that_cannot_begin_again_says_where(version: int, name: str, words: str, tmp_path: Path) -> None:
    fmu = foreign_fmu(tmp_path, version)
    start = fault(name) | ({"wheels": 4} if version == 3 else {})
    with FmuPlant(fmu, start, mapping=foreign_map(version)) as plant, pytest.raises(DeviceError) as told:
        plant.reset()
    assert str(told.value).startswith(f"FMU {fmu} {words}: wheel 1 fell off")


@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_that_gives_nothing_at_its_start_is_no_plant(version: int, tmp_path: Path) -> None:
    with pytest.raises(DeviceError) as told:
        FmuPlant(foreign_fmu(tmp_path, version), fault("fail_to_read", at_s=0.0), mapping=foreign_map(version))
    assert str(told.value) == (
        "the plant has no outputs at its start: the FMU refused to give its outputs (status 3, error) and did not say "
        "why"
    )


def test_what_shapes_an_fmu_is_given_where_it_is_opened(tmp_path: Path) -> None:
    fmu, sized = foreign_fmu(tmp_path, 3), {"wheels": 4}
    for start, again in (({}, sized), (sized, {})):
        with FmuPlant(fmu, start, mapping=foreign_map(3)) as plant, pytest.raises(BadInputError) as refused:
            plant.restart(again)
        assert str(refused.value) == "plant.start.wheels shapes the FMU; open it anew"
    with pytest.raises(BadInputError, match=r"^plant\.start\.wheels shapes the FMU; windows cannot set it$"):
        WindowStepper(fmu, sized, foreign_map(3), varied=("J",), outputs=())


def test_one_instance_a_process_where_the_fmu_says_so(tmp_path: Path) -> None:
    fmu = foreign_fmu(tmp_path, 2, canBeInstantiatedOnlyOncePerProcess="true")
    with FmuPlant(fmu, {}, mapping=foreign_map(2)) as plant:
        plant.reset()
        with pytest.raises(BadInputError, match="a process can have only one instance of it"):
            FmuPlant(fmu, {}, mapping=foreign_map(2))
        plant.step(TORQUE)
    FmuPlant(fmu, {}, mapping=foreign_map(2)).close()


def test_a_library_that_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.c").write_text("int nothing(void);\nint nothing(void) {\n    return 0;\n}\n")
    compile_shared([tmp_path / "empty.c"], tmp_path / f"empty{SUFFIX}")
    empty = (tmp_path / f"empty{SUFFIX}").read_bytes()
    for library, words in ((empty, "lacks a function of the standard"), (b"text", "its library cannot be loaded")):
        with pytest.raises(BadInputError, match=words):
            FmuPlant(foreign_fmu(tmp_path, 2, library=library), {}, mapping=foreign_map(2))


def test_the_shim_passes_the_sanitizers_over_a_foreign_fmu(tmp_path: Path) -> None:
    program = tmp_path / "driver"
    include = [f"-I{folder}" for folder in (SOURCES, SHIM_SOURCES[0].parent, PLANT_PORT.parent)]
    sources = [Path(__file__).with_name("shim_driver.c"), SOURCES / "wheels3.c", *SHIM_SOURCES]
    sanitize = ["-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    command = [*compiler(), *FLAGS, *sanitize, *include, *map(str, sources), "-o", str(program), "-lm"]
    compiled = subprocess.run(command, capture_output=True, text=True, check=False)
    assert compiled.returncode == 0, compiled.stderr
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


IGNORED = {  # what an importer may leave unused: the FMU's C code refuses each
    2: (
        *("canInterpolateInputs", "canRunAsynchronuously", "canNotUseMemoryManagementFunctions"),
        *("canGetAndSetFMUstate", "canSerializeFMUstate", "providesDirectionalDerivative", "needsExecutionTool"),
    ),
    3: (
        *("hasEventMode", "mightReturnEarlyFromDoStep", "canReturnEarlyAfterIntermediateUpdate"),
        *("providesIntermediateUpdate", "providesDirectionalDerivatives", "providesAdjointDerivatives"),
        *("canGetAndSetFMUState", "canSerializeFMUState", "providesPerElementDependencies", "needsExecutionTool"),
    ),
}


@pytest.mark.parametrize("version", [2, 3])
def test_what_need_not_be_used_changes_nothing(version: int, tmp_path: Path) -> None:
    poses = set()
    experiment = '<DefaultExperiment startTime="5" stopTime="6" tolerance="1e-3"/>'
    more = {"nominal": "3", "displayUnit": "x", "quantity": "Q", "unbounded": "true", "intermediateUpdate": "true"}
    default = variables2() if version == 2 else variables3()
    decorated = [v._replace(more={**v.more, **more}) if "Real" in v.kind or "Float" in v.kind else v for v in default]
    declared = [({name: "true"}, "", default) for name in IGNORED[version]]
    for attributes, text, variables in [({}, "", default), ({}, experiment, default), ({}, "", decorated), *declared]:
        fmu = foreign_fmu(tmp_path, version, variables=variables, more=text, **attributes)
        with FmuPlant(fmu, {}, foreign_map(version)) as plant:
            plant.step(TORQUE, 20)
            poses.add(plant.truth())
            assert plant.notices == ()
    assert len(poses) == 1


def changed(version: int, name: str, **more: str) -> list[Var]:
    """Return the foreign robot's variables, one of them with further attributes."""
    variables = variables2() if version == 2 else variables3()
    return [v._replace(more={**v.more, **more}) if v.name == name else v for v in variables]


@pytest.mark.parametrize("more", [{"min": "-5", "max": "5"}, {"max": "5"}, {"min": "-5"}])
@pytest.mark.parametrize("version", [2, 3])
def test_an_input_outside_its_range_ends_the_run(version: int, more: dict[str, str], tmp_path: Path) -> None:
    """The range is in N cm; the FMU's second wheel turns the other way round, which turns its range round."""
    name = "tau2" if version == 2 else "tau"
    fmu = foreign_fmu(tmp_path, version, variables=changed(version, name, **more))
    with FmuPlant(fmu, {}, foreign_map(version)) as plant:
        for torque_n_m in (0.05, -0.05):
            plant.step(Wheels(0.0, torque_n_m, 0.0, 0.0), 5)
        for torque_n_m, is_refused in ((0.050001, "min" in more), (-0.050001, "max" in more)):
            if is_refused:
                low, high = -0.05 if "max" in more else -math.inf, 0.05 if "min" in more else math.inf
                words = (
                    rf"wheel\.fr\.torque_n_m \({name} in the FMU\) is {torque_n_m}; the range .* {low:g} to {high:g}"
                )
                with pytest.raises(DeviceError, match=words):
                    plant.step(Wheels(0.0, torque_n_m, 0.0, 0.0))
                plant.reset()
            else:
                plant.step(Wheels(0.0, torque_n_m, 0.0, 0.0))


@pytest.mark.parametrize(
    ("version", "name", "more", "words"),
    [
        (2, "x", {"variability": "constant", "start": "1"}, r"'x' of wheels2\.fmu is constant, so it never moves"),
        (3, "phi", {"variability": "constant", "start": "1"}, r"'phi\[1,1\]' of wheels3\.fmu is constant"),
        (3, "tau", {"clocks": "36"}, r"'tau\[1\]' of wheels3\.fmu is clocked, and can be used in event mode only"),
        (3, "psi", {"clocks": "36"}, r'plant\.map\."pose\.heading_rad": \'psi\' of wheels3\.fmu is clocked'),
    ],
)
def test_a_variable_that_cannot_carry_its_signal_is_refused(
    version: int, name: str, more: dict[str, str], words: str, tmp_path: Path
) -> None:
    fmu = foreign_fmu(tmp_path, version, variables=changed(version, name, **more))
    with pytest.raises(BadInputError, match=words):
        FmuPlant(fmu, {}, foreign_map(version))
