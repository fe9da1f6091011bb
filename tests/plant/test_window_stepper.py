"""Many windows in one C call: the same bits as the plant stepped alone, for FMUs of ours and of others; failures."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

import tools.build.fmu
from hil.core.errors import BadInputError, DeviceError
from hil.core.plant_signals import OUTPUTS, POSE, SPEEDS, TWIST
from hil.core.types import Wheels
from hil.plant.fmu import FmuPlant
from hil.plant.mapping import SignalMap
from hil.plant.start import Value
from hil.plant.window_stepper import WindowStepper
from tests.support.foreign_fmu import FAULTS, foreign_fmu, foreign_map

SEEN = (*POSE, *TWIST, *SPEEDS)
ROWS = 100


def windows(number: int) -> np.ndarray:
    return np.random.default_rng(3).normal(0.0, 0.3, (number, ROWS, 4)).astype(np.float32)


def alone(
    fmu: Path, start: Mapping[str, Value], torque: np.ndarray, mapping: SignalMap | None = None
) -> list[list[float]]:
    """Step a plant of its own through one window, as the bridge steps it."""
    with FmuPlant(fmu, start, mapping) as plant:
        places = [OUTPUTS.index(name) for name in SEEN]
        rows = [[plant.context.signal[place] for place in places]]
        for row in torque:
            plant.step(Wheels(*map(float, row)), 1)
            rows.append([plant.context.signal[place] for place in places])
        return rows


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("contact", ["rigid", "slip"])
def test_each_case_equals_the_plant_stepped_alone(fmi: int, contact: str) -> None:
    fmu, torque = tools.build.fmu.build(fmi=fmi), windows(2)
    shared = {"contact": contact, "friction_coefficient": 0.04, "viscous_n_m_s_rad": 0.02}
    varied = ("mass_kg", "wheel_radius_m", "start_vx_m_s")
    cases = [(0, (20.0, 0.075, 0.1)), (1, (24.0, 0.08, -0.2)), (0, (20.0, 0.075, 0.1)), (0, (18.0, 0.07, 0.0))]
    with WindowStepper(fmu, shared, varied=varied, outputs=SEEN) as stepper:
        found = stepper.run(torque, [window for window, _ in cases], [values for _, values in cases])
    assert found.shape == (4, ROWS + 1, len(SEEN))
    for (window, values), rows in zip(cases, found, strict=True):
        expected = alone(fmu, shared | dict(zip(varied, values, strict=True)), torque[window])
        assert rows.tolist() == expected
    assert np.ptp(found[[0, 3]], axis=0).max() > 0.01, "the start values matter"


@pytest.mark.parametrize(("version", "grain_s"), [(2, 0.001), (3, 0.001), (2, 0.005), (3, 0.00025)])
def test_an_fmu_of_another_maker_by_its_map(version: int, grain_s: float, tmp_path: Path) -> None:
    """Also one that takes no other communication step than its own."""
    fmu = foreign_fmu(tmp_path, version, more=f'<DefaultExperiment stepSize="{grain_s}"/>')
    mapping = foreign_map(version)
    shared: dict[str, Value] = {"gear": "geared", "reversed": True, "label": "a robot", "grain": grain_s}
    torque = windows(1)
    with WindowStepper(fmu, shared, mapping, varied=("J",), outputs=SEEN) as stepper:
        found = stepper.run(torque, [0, 0], [[0.02], [0.05]])
    for inertia, rows in zip((0.02, 0.05), found, strict=True):
        assert rows.tolist() == alone(fmu, shared | {"J": inertia}, torque[0], mapping)


def test_a_failure_of_the_fmu_names_the_case_and_the_next_call_is_whole(tmp_path: Path) -> None:
    fmu, mapping = foreign_fmu(tmp_path, 2), foreign_map(2)
    shared: dict[str, Value] = {"fault": FAULTS.index("say_error")}
    with WindowStepper(fmu, shared, mapping, varied=("fault_time",), outputs=POSE) as stepper:
        whole = stepper.run(windows(1), [0], [[1e9]])
        with pytest.raises(DeviceError, match=r"wheels2\.fmu failed with fault_time = 0\.01: ."):
            stepper.run(windows(1), [0, 0], [[1e9], [0.01]])
        assert stepper.run(windows(1), [0], [[1e9]]).tolist() == whole.tolist()


def test_an_fmu_that_has_reported_a_fatal_error_is_stepped_no_more(tmp_path: Path) -> None:
    fmu, shared = foreign_fmu(tmp_path, 3), {"fault": FAULTS.index("say_fatal")}
    with WindowStepper(fmu, shared, foreign_map(3), varied=("fault_time",), outputs=POSE) as stepper:
        with pytest.raises(DeviceError, match=r"wheels3\.fmu failed with fault_time = 0\.01: wheel 1 fell off"):
            stepper.run(windows(1), [0], [[0.01]])
        with pytest.raises(DeviceError) as told:
            stepper.run(windows(1), [0], [[1e9]])
    assert str(told.value) == f"FMU {fmu} has reported a fatal error and cannot be stepped: wheel 1 fell off"


def test_a_value_that_the_fmu_refuses_is_our_error() -> None:
    with WindowStepper(tools.build.fmu.build(), {}, varied=("mass_kg",), outputs=POSE) as stepper:
        with pytest.raises(DeviceError, match=r"failed with mass_kg = -1: .*mass_kg"):
            stepper.run(windows(1), [0], [[-1.0]])
        stepper.close()
        with pytest.raises(DeviceError, match="the FMU is closed; make a new stepper"):
            stepper.run(windows(1), [0], [[20.0]])


@pytest.mark.parametrize(
    ("varied", "outputs", "message"),
    [
        (["mas_kg"], POSE, "mass_kg"),
        (["contact"], POSE, "Enumeration; expected a float"),
        (["pose.x_m"], POSE, "gives this output its value itself"),
        (["mass_kg"], ["pose.x"], "pose.x_m"),
    ],
)
def test_names_that_do_not_fit_are_refused(varied: Sequence[str], outputs: Sequence[str], message: str) -> None:
    with pytest.raises(BadInputError, match=message):
        WindowStepper(tools.build.fmu.build(), {}, varied=varied, outputs=outputs)


def test_arrays_that_do_not_fit_together_never_reach_c() -> None:
    with WindowStepper(tools.build.fmu.build(), {}, varied=("mass_kg",), outputs=SEEN) as stepper:
        for torque, window, start, words in (
            (windows(1)[0], [0], [[20.0]], r"torque_n_m has shape \(100, 4\); expected \(windows, rows, 4\)"),
            (windows(1)[:, :, :3], [0], [[20.0]], r"torque_n_m has shape \(1, 100, 3\); expected \(windows, rows, 4\)"),
            (windows(2), [1, 2], [[20.0], [20.0]], "window 2 of 2; they are counted from 0"),
            (windows(1), [0], [[20.0, 1.0]], r"start has shape \(1, 2\); expected \(1, 1\)"),
            (windows(1), [0, 0], [[20.0]], r"start has shape \(1, 1\); expected \(2, 1\)"),
        ):
            with pytest.raises(ValueError, match=f"^{words}$"):
                stepper.run(torque, window, start)
