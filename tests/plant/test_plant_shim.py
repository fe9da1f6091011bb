"""The plant behind the firmware's plant port: the shim against FMPy's methods, wiring, failures, life."""

import gc
import math
import random
import struct
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hil.core.errors import BadInputError, DeviceError
from hil.core.types import Wheels
from hil.plant import shim
from hil.plant.fmu import FmuPlant
from hil.plant.mapping import Connection, Wiring
from hil.plant.start import Value
from tests.support.plant_testbed import DESCRIPTION, FMU, REFERENCE, TORQUES, WHEELS, last_successful_time_s, slave

START = {"friction_coefficient": 0.05, "viscous_n_m_s_rad": 0.01, "start_heading_rad": 0.3}
ZERO = Wheels(0.0, 0.0, 0.0, 0.0)
REALS = [v.valueReference for v in DESCRIPTION.modelVariables if v.causality == "output" and v.type == "Real"]
COUNTS = [REFERENCE[f"wheel.{wheel}.count"] for wheel in WHEELS]


def single(value: float) -> float:
    return struct.unpack("f", struct.pack("f", value))[0]


@pytest.fixture
def plant() -> Iterator[FmuPlant]:
    with FmuPlant(FMU, START) as it:
        yield it


class Port:
    """The plant port as the firmware sees it: addresses, a drive and a sense."""

    def __init__(self, plant: FmuPlant) -> None:
        ffi = self.ffi = plant._ffi
        self.drive, self.sense = ffi.new("wheel_drive *"), ffi.new("wheel_sense *")
        self._exchange = ffi.cast("wheel_plant_exchange", plant.exchange_address)
        self._context = ffi.cast("void *", plant.context_address)
        self.drive.enabled = 1

    def exchange(self, torque: list[float] | None) -> int:
        if torque is None:
            return int(self._exchange(self._context, self.ffi.NULL, self.sense))
        self.drive.torque_n_m = torque
        status = int(self._exchange(self._context, self.drive, self.sense))
        self.drive.tick += 1
        return status

    def values(self) -> tuple[Any, ...]:
        sense = self.sense
        return (list(sense.count), list(sense.current_a), list(sense.gyro_rad_s))


def test_equals_fmpy_bit_for_bit(plant: FmuPlant) -> None:
    """A thousand ticks of random torques, through the plant port and through FMPy's methods."""
    rng = random.Random(7)
    port = Port(plant)
    by_name = {reference: name for name, reference in REFERENCE.items()}
    with slave(START) as fmu:
        for n in range(1000):
            torque = [single(rng.uniform(-2, 2)) for _ in WHEELS]
            assert port.exchange(torque) == 0
            fmu.setReal([*TORQUES, REFERENCE["drive.enabled"]], [*torque, 1.0])
            fmu.doStep(n * 1_000_000 / 1e9, 1e-3)
            out = dict(zip([by_name[r] for r in REALS], fmu.getReal(REALS), strict=True))
            fix = plant.truth()
            assert [*fix.pose, *fix.twist] == list(out.values())[:6]
            assert list(plant.wheel_speeds()) == [out[f"wheel.{w}.speed_rad_s"] for w in WHEELS]
            assert port.values() == (
                [count & 0xFFFF for count in fmu.getInteger(COUNTS)],
                [single(out[f"wheel.{w}.current_a"]) for w in WHEELS],
                [0.0, 0.0, single(out["gyro.z_rad_s"])],
            )
            assert port.sense.tick == n + 1
    assert plant.truth().time_ns == 1_000_000_000
    assert last_successful_time_s(plant.instance.fmu) == pytest.approx(1.0, abs=1e-12)
    assert max(abs(value) for value in plant.truth().pose) > 0.01, "the robot did not move"


def test_without_a_drive_no_time_passes(plant: FmuPlant) -> None:
    port = Port(plant)
    plant.step(Wheels(1.0, 0.5, 1.0, 0.5), 20)
    before = plant.truth()
    assert port.exchange(None) == 0
    assert plant.truth() == before
    assert port.sense.tick == 20


def test_encoder_counts_follow_the_angle_and_wrap() -> None:
    """Turning left by 2 rad/s for 3 s: the right wheels turn by 48 rad, the left ones back by as much."""
    start = {"start_yaw_rate_rad_s": 2.0, "counts_per_revolution": 8192}
    with FmuPlant(FMU, start) as plant:
        port = Port(plant)
        for _ in range(3000):
            assert port.exchange([0.0] * 4) == 0
        counts = 2.0 * 0.6 / 0.075 * 3.0 / math.tau * 8192
        assert counts > 0x7FFF, "the wrap is not reached"
        assert list(port.sense.count) == [
            math.floor(-counts) & 0xFFFF,
            math.floor(counts) & 0xFFFF,
            math.floor(counts) & 0xFFFF,
            math.floor(-counts) & 0xFFFF,
        ]


def test_wiring_permutes_and_reverses() -> None:
    """Channel c drives wheel w: the port sees the unwired robot, sorted and signed; the truth is equal."""
    wheels, signs = (2, 0, 3, 1), (1, -1, -1, 1)
    torque = [0.5, -0.25, 1.0, 0.75]
    with FmuPlant(FMU, START) as plain, FmuPlant(FMU, START) as wired:
        wired.wire(wheels, signs)
        one, other = Port(plain), Port(wired)
        for _ in range(300):
            assert one.exchange(torque) == 0
            assert other.exchange([s * torque[w] for w, s in zip(wheels, signs, strict=True)]) == 0
        assert wired.truth() == plain.truth()
        assert wired.wheel_speeds() == plain.wheel_speeds()
        assert list(other.sense.current_a) == [s * one.sense.current_a[w] for w, s in zip(wheels, signs, strict=True)]
        assert list(other.sense.count) == [s * one.sense.count[w] & 0xFFFF for w, s in zip(wheels, signs, strict=True)]
        wired.reset()
        assert other.exchange([s * torque[w] for w, s in zip(wheels, signs, strict=True)]) == 0
        plain.reset()
        plain.step(Wheels(*torque))
        assert wired.truth() == plain.truth(), "a reset must keep the wiring"


@pytest.mark.parametrize("bad", [((0, 1, 2, 2), (1, 1, 1, 1)), ((0, 1, 2, 3), (1, 0, 1, 1)), ((0, 1), (1, 1))])
def test_bad_wiring_is_refused(plant: FmuPlant, bad: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
    with pytest.raises(BadInputError, match="each of 0 to 3 once"):
        plant.wire(*bad)


def test_a_failure_says_why_and_stays_until_reset(plant: FmuPlant) -> None:
    port = Port(plant)
    start = plant.truth()
    plant.step(Wheels(0.5, 0.5, 0.5, 0.5), 10)
    good = plant.truth()
    with pytest.raises(DeviceError, match=r"at 0\.01 s: wheel\.rr\.torque_n_m = nan; expected a finite number"):
        plant.step(Wheels(0.0, 0.0, math.nan, 0.0))
    assert port.exchange([0.0] * 4) != 0
    assert "wheel.rr.torque_n_m" in plant.message, "the first reason is kept"
    assert plant.truth() == good
    plant.reset()
    assert plant.truth() == start
    plant.step(Wheels(0.5, 0.5, 0.5, 0.5), 10)
    assert plant.truth() == good


def test_a_value_that_the_fmu_refuses_between_two_ticks_is_told(plant: FmuPlant) -> None:
    with pytest.raises(DeviceError) as told:
        plant.set_variable("wheel.fl.grip_factor", -1.0)
    assert str(told.value) == (
        "the plant refused wheel.fl.grip_factor = -1: wheel.fl.grip_factor = -1; expected a number from 0 to 10"
    )


def test_a_state_that_overflows_is_a_failure(plant: FmuPlant) -> None:
    with pytest.raises(DeviceError, match=r"no longer finite|turns by"):
        plant.step(Wheels(3e38, -3e38, 3e38, -1e38), 200_000)


def test_plants_are_independent(plant: FmuPlant) -> None:
    with FmuPlant(FMU, {"mass_kg": 5.0}) as other:
        before = other.truth()
        plant.step(Wheels(1.0, 1.0, 1.0, 1.0), 100)
        assert other.truth() == before
        moved = plant.truth()
    assert plant.truth() == moved
    plant.step(ZERO)
    assert plant.truth() != moved


def test_closing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Closing twice is fine; later calls fail with a sentence; no file and no change of directory stays."""
    monkeypatch.chdir(tmp_path)
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(scratch))
    plant = FmuPlant(FMU, {})
    assert Path.cwd() == tmp_path
    port = Port(plant)
    plant.close()
    plant.close()
    assert port.exchange([0.0] * 4) != 0
    with pytest.raises(DeviceError, match="the FMU is closed"):
        plant.step(ZERO)
    with pytest.raises(DeviceError, match="the plant is closed"):
        plant.reset()
    assert list(scratch.iterdir()) == []


def test_a_refused_start_leaves_nothing_behind(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(BadInputError):
        FmuPlant(FMU, {"mass_kg": -1.0})
    gc.collect()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("start", "words"),
    [
        (
            {"mas_kg": 24.0},
            r"plant\.start\.mas_kg: mecanum\.fmu has no such variable; did you mean 'mass_kg'\?",
        ),
        ({"pose.x_m": 1.0}, r"plant\.start\.pose\.x_m: .* gives this output its value itself"),
        ({"mass_kg": -1.0}, r"plant\.start\.mass_kg = -1; expected a number from 0\.01 to 10000"),
        ({"mass_kg": math.inf}, r"plant\.start\.mass_kg = inf; expected a finite number"),
        (
            {"counts_per_revolution": 0.5},
            r"plant\.start\.counts_per_revolution = 0\.5; expected a whole number",
        ),
        ({"counts_per_revolution": 1e12}, r"expected a whole number of 32 bits"),
        ({"coriolis": 3}, r"plant\.start\.coriolis = 3; expected one of 'rigid' \(1\), 'paper' \(2\)"),
        (
            {"coriolis": "papre"},
            r"plant\.start\.coriolis = 'papre'; expected an item of the enumeration; did you mean 'paper'\?",
        ),
    ],
)
def test_a_bad_start_is_refused(start: dict[str, Value], words: str) -> None:
    with pytest.raises(BadInputError, match=words):
        FmuPlant(FMU, start)


def test_the_range_of_an_input_is_in_the_bridge_s_unit_and_an_input_without_one_has_none() -> None:
    ffi, _ = shim.load()
    variable = SimpleNamespace(
        name="u", valueReference=7, type="Real", min="-1", max="4", start="0", declaredType=None, shape=()
    )
    free = SimpleNamespace(**vars(variable) | {"name": "free", "valueReference": 8, "min": None, "max": None})
    rows = [
        Connection(0, variable, 0, 2.0, 3.0),
        Connection(2, variable, 0, -2.0, 3.0),
        Connection(3, free, 0, 2.0, 3.0),
    ]
    context = ffi.new("cosim *")
    kept = shim.connect(context, Wiring(tuple(rows), (), frozenset({1}), ()), lambda *_: ffi.NULL)
    assert kept
    assert [(context.low[place], context.high[place]) for place in range(4)] == [
        (1.0, 11.0), (-math.inf, math.inf), (-5.0, 5.0), (-math.inf, math.inf)
    ]  # fmt: skip
    assert context.is_bounded
    assert [bool(context.derived[place]) for place in range(3)] == [False, True, False]
    assert context.derives
    unbounded = ffi.new("cosim *")
    kept = shim.connect(unbounded, Wiring((rows[2],), (), frozenset(), ()), lambda *_: ffi.NULL)
    assert (unbounded.is_bounded, unbounded.derives) == (0, 0)
