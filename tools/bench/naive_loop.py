"""The paper's circle as one would write it first: each library used as its own tutorial shows.

FMPy's class over the shipped FMU, cantools with wheel.dbc on both sides of a ``virtual`` bus of python-can, AFDSC in
NumPy, and one ``rr.log`` a signal. On the bus are the frames that the bridge has on its wire in a tick: command, STEP,
feedback, STEP_DONE. The robot's side has no firmware: it puts the received torques on the FMU and sends its
measurements. So there is less to do than in the bridge, and nothing is made slow on purpose.
"""

import math
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import can
import cantools.database
import numpy as np
import rerun as rr
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

import plant_fmu
from hil.core.model import RobotModel
from hil.core.types import WHEEL_NAMES, Acceleration, Pose, Reference, State, Twist
from hil.laws.afdsc import Afdsc
from tools.bench.controller_step import NumpyAfdsc

DT_S = 0.001
SLOW_EVERY = 5  # ticks: currents and inertial sensors come at 200 Hz, as from the firmware
DBC = Path(__file__).parents[2] / "firmware_protocol" / "wheel.dbc"
INPUTS = [*(f"wheel.{wheel}.torque_n_m" for wheel in WHEEL_NAMES), "drive.enabled"]
OUTPUTS = [
    *("pose.x_m", "pose.y_m", "pose.heading_rad", "twist.vx_m_s", "twist.vy_m_s", "twist.yaw_rate_rad_s"),
    *(f"wheel.{wheel}.{name}" for name in ("speed_rad_s", "current_a") for wheel in WHEEL_NAMES),
    *(f"{sensor}_{unit}" for sensor, unit in (("gyro.x", "rad_s"), ("gyro.y", "rad_s"), ("gyro.z", "rad_s"))),
    *(f"accelerometer.{axis}_m_s2" for axis in "xyz"),
]
COUNTS = [f"wheel.{wheel}.count" for wheel in WHEEL_NAMES]


class NaiveNode:
    """Who speaks wheel.dbc on the bus."""

    def __init__(self, database: Any) -> None:
        self.bus = can.Bus(interface="virtual", channel="naive_loop")
        self.database = database

    def send(self, name: str, signals: dict[str, float]) -> None:
        """Encode a message and send it."""
        message = self.database.get_message_by_name(name)
        self.bus.send(can.Message(arbitration_id=message.frame_id, data=message.encode(signals), is_extended_id=False))


class NaiveRobot(NaiveNode):
    """The robot's side: the FMU on the bus."""

    def __init__(self, database: Any, start: Mapping[str, Any]) -> None:
        super().__init__(database)
        path = str(plant_fmu.path(2))
        description = read_model_description(path)
        self.references = {variable.name: variable.valueReference for variable in description.modelVariables}
        self.folder = extract(path)
        self.fmu = FMU2Slave(
            guid=description.guid,
            unzipDirectory=self.folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="naive",
        )
        self.fmu.instantiate()
        self.fmu.setupExperiment(startTime=0.0)
        for variable in description.modelVariables:
            if variable.name in start:
                value = start[variable.name]
                if variable.type == "Real":
                    self.fmu.setReal([variable.valueReference], [value])
                else:
                    self.fmu.setInteger([variable.valueReference], [int(value)])
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        self.inputs = [self.references[name] for name in INPUTS]
        self.outputs = [self.references[name] for name in OUTPUTS]
        self.counts = [self.references[name] for name in COUNTS]
        self.values = dict(zip(OUTPUTS, self.fmu.getReal(self.outputs), strict=True))
        self.sequence = 0

    def serve(self) -> None:
        """Take the newest torques, and let a millisecond pass for each STEP."""
        while (message := self.bus.recv(timeout=0)) is not None:
            received = self.database.decode_message(message.arbitration_id, message.data)
            if "substeps" in received:
                self.step(received["tick"])
                self.send("STEP_DONE", {"tick": received["tick"] + received["substeps"]})
            else:
                self.sequence = received["sequence"]
                self.fmu.setReal(self.inputs, [*(received[f"{wheel}_n_m"] for wheel in WHEEL_NAMES), 1.0])

    def step(self, tick: int) -> None:
        """Let a millisecond pass, and send what was measured."""
        self.fmu.doStep(currentCommunicationPoint=tick * DT_S, communicationStepSize=DT_S)
        self.values = values = dict(zip(OUTPUTS, self.fmu.getReal(self.outputs), strict=True))
        counts = self.fmu.getInteger(self.counts)
        is_whole = tick % SLOW_EVERY == 0
        self.send(
            "TICK",
            {
                "time_us": tick * 1000,
                "sequence": self.sequence,
                "command_age_ms": 0,
                "state": 3,
                "parts": 31 if is_whole else 3,
                "snapshot": tick % 256,
            },
        )
        self.send("ENCODERS", {f"{w}_count": count % 65536 for w, count in zip(WHEEL_NAMES, counts, strict=True)})
        self.send("WHEEL_SPEEDS", {f"{w}_rad_s": values[f"wheel.{w}.speed_rad_s"] for w in WHEEL_NAMES})
        if is_whole:
            self.send("CURRENTS", {f"{w}_a": values[f"wheel.{w}.current_a"] for w in WHEEL_NAMES})
            inertial = {f"{axis}_m_s2": values[f"accelerometer.{axis}_m_s2"] for axis in "xyz"}
            self.send("ACCELEROMETER", inertial | {"tick": tick % 65536})
            self.send(
                "GYRO", {f"{axis}_rad_s": values[f"gyro.{axis}_rad_s"] for axis in "xyz"} | {"tick": tick % 65536}
            )

    def close(self) -> None:
        """Free the FMU and release the bus."""
        self.bus.shutdown()
        self.fmu.terminate()
        self.fmu.freeInstance()
        shutil.rmtree(self.folder)


class NaiveLoop(NaiveNode):
    """The host's side with the robot beside it; ``record`` is the ``.rrd`` file, or None."""

    def __init__(self, model: RobotModel, start: Mapping[str, Any], record: Path | None) -> None:
        super().__init__(cantools.database.load_file(DBC))
        self.step_done = self.database.get_message_by_name("STEP_DONE").frame_id
        self.robot = NaiveRobot(self.database, start)
        self.law = NumpyAfdsc(model, Afdsc.Options())
        self.limit_n_m = model.torque_limit_n_m
        self.heard: dict[str, float] = {}
        self.record = record

    def run(self, ticks: int) -> tuple[list[int], float]:
        """Run so many ticks, each with its logging; return when each ended [ns], and the last planar error [m]."""
        stream: Any = None
        if self.record is not None:
            stream = rr.RecordingStream("naive_loop")
            stream.save(self.record)
        stamps_ns, error_m = [], math.nan
        for tick in range(ticks):
            signals = self.tick(tick)
            if stream is not None:
                stream.set_time("tick", sequence=tick)
                for name, value in signals.items():
                    stream.log(name, rr.Scalars(value))
            error_m = signals["error/planar_m"]
            stamps_ns.append(time.perf_counter_ns())
        if stream is not None:
            stream.flush()
            stream.disconnect()
        return stamps_ns, error_m

    def tick(self, tick: int) -> dict[str, float]:
        """Sense, refer, control, command; return the signals."""
        t_s = tick * DT_S
        while (message := self.bus.recv(timeout=0)) is not None:
            heard = self.database.decode_message(message.arbitration_id, message.data, decode_choices=False)
            if message.arbitration_id == self.step_done:
                if heard["tick"] != tick:
                    raise SystemExit(f"the naive robot is at tick {heard['tick']} where {tick} was expected")
            else:
                self.heard.update(heard)
        truth = self.robot.values
        state = State(
            Pose(truth["pose.x_m"], truth["pose.y_m"], truth["pose.heading_rad"]),
            Twist(truth["twist.vx_m_s"], truth["twist.vy_m_s"], truth["twist.yaw_rate_rad_s"]),
        )
        reference = circle(t_s)
        if tick == 0:
            self.law.begin(reference, state)
        torque = np.clip(self.law.update(reference, state, DT_S), -self.limit_n_m, self.limit_n_m)
        fields = {f"{wheel}_n_m": float(torque[i]) for i, wheel in enumerate(WHEEL_NAMES)}
        self.send("TORQUE_COMMAND", {**fields, "sequence": tick % 256, "session": 1})
        self.send("STEP", {"tick": tick, "substeps": 1})
        self.robot.serve()
        error = np.array(state.pose) - np.array(reference.pose)
        return {
            "loop/t_s": t_s,
            **{f"reference/{axis}": value for axis, value in zip(Pose._fields, reference.pose, strict=True)},
            **{f"reference/{axis}": value for axis, value in zip(Twist._fields, reference.twist, strict=True)},
            **{f"pose/{axis}": value for axis, value in zip(Pose._fields, state.pose, strict=True)},
            **{f"twist/{axis}": value for axis, value in zip(Twist._fields, state.twist, strict=True)},
            **{f"error/{axis}": float(value) for axis, value in zip(Pose._fields, error, strict=True)},
            "error/planar_m": float(np.linalg.norm(error[:2])),
            **{f"wheel/{wheel}/torque_command_n_m": float(torque[i]) for i, wheel in enumerate(WHEEL_NAMES)},
            **{f"robot/{name}": value for name, value in self.heard.items()},
        }

    def close(self) -> None:
        """Release the bus and the FMU."""
        self.robot.close()
        self.bus.shutdown()


def circle(t_s: float) -> Reference:
    """Return the paper's circle: 1 m, once in 15 s, the heading fixed."""
    rate = math.tau / 15.0
    c, s = np.cos(rate * t_s), np.sin(rate * t_s)
    return Reference(
        Pose(c, s, math.pi / 4),
        Twist(-rate * s, rate * c, 0.0),
        Acceleration(-(rate**2) * c, -(rate**2) * s, 0.0),
    )
