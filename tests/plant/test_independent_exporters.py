"""FMUs from exporters that others wrote: pythonfmu for FMI 2.0, pythonfmu3 for FMI 3.0; a Python class is inside."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fmpy import simulate_fmu

from hil.core.errors import DeviceError
from hil.core.plant_signals import ANGLES, OUTPUTS
from hil.core.types import WHEEL_NAMES, Wheels
from hil.plant.fmu import FmuPlant
from hil.plant.mapping import Row, SignalMap
from hil.plant.remote import RemotePlant

SLAVE = """
from {package} import {base}, {causality}, {real}

class Wheels({base}):
    def __init__(self, **arguments):
        super().__init__(**arguments)
        for name in ("tau1", "tau2", "tau3", "tau4"):
            self.add(name, {causality}.input)
        for name in ("phi1", "phi2", "phi3", "phi4", "x", "y", "psi"):
            self.add(name, {causality}.output)
        self.speed = [0.0] * 4

    def add(self, name, causality):
        setattr(self, name, 0.0)
        self.register_variable({real}(name, causality=causality))

    def do_step(self, from_s, step_s):
        if from_s >= 0.15:
            print("it is getting hot")
            raise RuntimeError("the gearbox is on fire")
        for i in range(4):
            self.speed[i] += getattr(self, f"tau{{i + 1}}") / 0.02 * step_s
            setattr(self, f"phi{{i + 1}}", getattr(self, f"phi{{i + 1}}") + self.speed[i] * step_s)
        self.x = 0.025 * (self.phi1 + self.phi2 + self.phi3 + self.phi4)
        return True
"""
MAP = SignalMap(
    {
        **{f"wheel.{wheel}.torque_n_m": Row(f"tau{i}") for i, wheel in enumerate(WHEEL_NAMES, 1)},
        **{f"wheel.{wheel}.angle_rad": Row(f"phi{i}") for i, wheel in enumerate(WHEEL_NAMES, 1)},
        "pose.x_m": Row("x", scale=2.0),
        "pose.y_m": Row("y"),
        "pose.heading_rad": Row("psi"),
    },
    counts_per_revolution=1000,
    torque_constant_n_m_a=0.5,
)


EXPORTERS = pytest.mark.parametrize(
    ("package", "base", "causality", "real"),
    [
        ("pythonfmu", "Fmi2Slave", "Fmi2Causality", "Real"),
        ("pythonfmu3", "Fmi3Slave", "Fmi3Causality", "Float64"),
    ],
)


def export(folder: Path, name: str, text: str, package: str, *options: str) -> Path:
    """Export a slave. Its module is imported into this interpreter, where a name can be taken once."""
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is missing: pip install {package}")
    (folder / f"{name}_of_{package}.py").write_text(text)
    command = [sys.executable, "-m", package, "build", "-f", f"{name}_of_{package}.py", *options]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return folder / "Wheels.fmu"


@EXPORTERS
def test_an_fmu_of_another_exporter_is_the_plant(
    package: str, base: str, causality: str, real: str, tmp_path: Path
) -> None:
    export(tmp_path, "robot", SLAVE.format(package=package, base=base, causality=causality, real=real), package)
    with FmuPlant(tmp_path / "Wheels.fmu", {}, mapping=MAP) as plant:
        torque = Wheels(1.0, 2.0, 3.0, 4.0)
        plant.step(torque, 100)
        # Semi-implicit Euler: the angle after n steps is a h^2 n (n + 1) / 2.
        angles = [t / 0.02 * 1e-6 * 100 * 101 / 2 for t in torque]
        assert plant.truth().pose.x_m == pytest.approx(2.0 * 0.025 * sum(angles), rel=1e-9)
        assert plant.wheel_speeds() == pytest.approx([t / 0.02 * 0.1 for t in torque], rel=1e-9)
    with RemotePlant(tmp_path / "Wheels.fmu", {}, mapping=MAP) as plant:
        with pytest.raises(DeviceError, match=r"stopped at 0\.15 s: .*the gearbox is on fire"):
            plant.step(torque, 200)
        printed, logged = plant.output.end()
        assert printed == "it is getting hot"
        assert re.fullmatch(r"log \(fatal\): .*RuntimeError\('the gearbox is on fire'\)", logged)


@EXPORTERS
def test_an_fmu_that_steps_by_its_own_size_agrees_with_fmpy(
    package: str, base: str, causality: str, real: str, tmp_path: Path
) -> None:
    """It goes 10 ms forward whatever it is asked, as fixed-step exports do, and declares that."""
    text = SLAVE.format(package=package, base=base, causality=causality, real=real)
    text = text.replace(
        "arguments)\n", "arguments)\n        self.default_experiment = DefaultExperiment(step_size=0.01)\n", 1
    )
    text = text.replace("do_step(self, from_s, step_s):", "do_step(self, from_s, _):\n        step_s = 0.01", 1)
    text = text.replace("import ", "import DefaultExperiment, ", 1)
    fmu = export(tmp_path, "fixed", text, package, "--no-variable-step")
    torque = np.random.default_rng(2).uniform(-1.0, 1.0, (14, 4)).astype(np.float32).astype(float)
    names = ["time", *(f"tau{i}" for i in range(1, 5))]
    held = np.array([(t, *row) for n, row in enumerate(torque) for t in (n * 0.01, n * 0.01 + 0.0099)])
    signals = np.array([tuple(row) for row in held], dtype=[(name, float) for name in names])
    output = ["phi1", "phi2", "phi3", "phi4", "x"]
    expected = simulate_fmu(
        str(fmu), stop_time=0.14, step_size=0.01, output_interval=0.01, input=signals, output=output, validate=False
    )
    with FmuPlant(fmu, {}, mapping=MAP) as plant:
        for tick in range(140):
            plant.step(Wheels(*torque[tick // 10] if tick % 10 == 0 else (9.0, 9.0, 9.0, 9.0)))
            row = expected[(tick + 1) // 10]
            assert plant.truth().pose.x_m == pytest.approx(2.0 * row["x"], rel=1e-12)
        angles = plant.context.signal[OUTPUTS.index(ANGLES[0]) : OUTPUTS.index(ANGLES[3]) + 1]
        assert list(angles) == pytest.approx([row[name] for name in output[:4]], rel=1e-12)
