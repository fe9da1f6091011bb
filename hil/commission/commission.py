"""Commissions the robot of a robot's file: opens it, does the steps, and writes what was found into the file."""

import contextlib
import datetime
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from hil.commission import robot_file
from hil.commission.findings import Findings
from hil.commission.person import Onlooker, Person, Terminal
from hil.commission.procedure import Procedure
from hil.commission.session import Session
from hil.core.errors import BadInputError, HilError
from hil.core.options import format_value
from hil.core.types import WHEEL_NAMES
from hil.robot.parameters import ParameterClient
from hil.robot.wheel_map import IMU_AXES
from hil.runtime.robots import link_of, wiring
from hil.scenario import BASE, Scenario, load
from hil.scenario.commission import CommissionTable
from hil.scenario.motors import make_driver
from hil.wire.device_lock import device_held

_MEANWHILE = {"speed_kp_n_m_s_rad": 0.0, "speed_ki_n_m_rad": 0.0, "encoder_fault_s": 1.0}
"""Of the firmware while a robot is commissioned: no loop is closed, and no encoder is judged by the other three."""


class Commissioned(NamedTuple):
    """What came out: the table that the robot's file has now, the values written with it, and the largest motions."""

    table: CommissionTable
    values: dict[str, object]
    furthest_m: float
    fastest_rad_s: float


def commission(
    file: Path,
    *,
    person: Person | None = None,
    sets: Sequence[str] = (),
    link: str | None = None,
    anew: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> Commissioned:
    """Do the steps that are left, and keep each in the robot's file as soon as it is done.

    Without a ``person`` a terminal is asked; for a virtual robot in this process its truth. ``anew`` forgets what was
    found before. Raises BadInputError before anything is opened, StepError for a step that has failed, DeviceError and
    LinkError for a robot that is lost, RunInterruptedError when the person stops; what was found before is in the file.
    """
    told, session_scenario = _scenarios(file, sets, link)
    url = link_of(session_scenario)
    # What a virtual robot has shown is nothing that a real one can go on with, nor the other way round.
    anew = anew or told.commission.virtual != url.is_within_process
    if told.commission.state == "done" and not anew:
        raise BadInputError(f"{file}: this robot is commissioned ({told.commission.date}); do it again with --anew")
    findings = Findings() if anew else Findings.kept(told.commission, told.device)
    with (
        device_held(url, f"hil commission {file}"),
        _without_speed_loop(session_scenario),
        Session(session_scenario, told.device.imu) as session,
    ):
        for warning in session.connect():
            say(f"warning: {warning}")
        say(f"robot: {session.firmware}")

        def save(step: str) -> None:
            findings.finish(step, datetime.date.today().isoformat(), session.firmware)  # noqa: DTZ011 - the user's own
            robot_file.write(file, findings.document())
            say(f"{step}: done, and written into {file}")

        robot_file.write(file, findings.begin(virtual=url.is_within_process))
        Procedure(session, person or _person(session), findings, say, save).run()
        say(
            f"the furthest way of a wheel's rim in a pulse was {session.furthest_m * 100:.1f} cm, the largest speed "
            f"of a wheel {session.fastest_rad_s:.1f} rad/s"
        )
        return Commissioned(findings.table, dict(findings.values), session.furthest_m, session.fastest_rad_s)


def _scenarios(file: Path, sets: Sequence[str], link: str | None) -> tuple[Scenario, Scenario]:
    """Return the scenario as the robot's file tells it, and the one in which every output is just a number."""
    told = load(BASE, robot=file, set=[*sets, "expect=[]", "fault=[]"], link=link)
    is_base = told.device.is_makers and make_driver(told).capabilities.is_twist
    if any(text.partition("=")[0].removeprefix("firmware.") in _MEANWHILE for text in sets):
        raise BadInputError(
            "--set of the speed loop's gains or of encoder_fault_s: commissioning sets them; leave it out"
        )
    mode = "lockstep" if link_of(told).is_within_process else "realtime"
    true = wiring(told)
    plain: dict[str, object] = {
        "controller.command": "speed" if is_base else "torque",
        "controller.law": "pid",
        "controller.gains": {},
        "estimator.source": "odometry",
        # The loops of a base are its own; an emulated one has its gains from here.
        **({} if is_base else {f"firmware.{name}": value for name, value in _MEANWHILE.items()}),
        "device.wheels": WHEEL_NAMES,
        "device.reversed": (),
        "device.imu": IMU_AXES,
    }
    if mode == "lockstep":  # the virtual robot is wired as its file says, if nothing says otherwise
        reversed_wheels = [
            wheel
            for wheel, sign in zip(
                told.plant.wiring.wheels or told.device.wheels, true.motors.sign_of_channel, strict=True
            )
            if sign < 0
        ]
        plain |= {
            "plant.wiring.wheels": told.plant.wiring.wheels or told.device.wheels,
            "plant.wiring.reversed": reversed_wheels,
            "plant.wiring.imu": told.plant.wiring.imu or told.device.imu,
        }
    texts = [f"{key}={format_value(value)}" for key, value in plain.items()]
    session = load(BASE, robot=file, set=[*sets, "expect=[]", "fault=[]", *texts], link=link, mode=mode)
    return told, session


@contextlib.contextmanager
def _without_speed_loop(scenario: Scenario) -> Iterator[None]:
    """Let our firmware on a real board hold ``_MEANWHILE``; that is never stored, and a reset ends it too."""
    url = link_of(scenario)
    if scenario.device.is_makers or url.is_within_process:
        yield
        return

    def write(values: Mapping[str, float]) -> dict[str, float]:
        with contextlib.closing(url.open_host()) as opened:
            client = ParameterClient(opened)
            held = {row.name: row.value for row in client.read() if row.name in _MEANWHILE}
            client.write(client.check(values))
            return held

    held = write(_MEANWHILE)
    try:
        yield
    finally:
        with contextlib.suppress(HilError):  # a robot that is lost, or was reset, has its stored gains again
            write(held)


def _person(session: Session) -> Person:
    local, truth = session.bench.local, session.bench.truth
    if local is None or truth is None:
        if not sys.stdin.isatty():
            raise BadInputError("stdin is not a terminal; give --answers FILE in the place of a person")
        return Terminal()

    def pose() -> object:
        fix = truth.poll()
        assert fix is not None
        return fix.pose

    return Onlooker(wiring(session.scenario), pose)
