"""Commissions the robot of a robot's file: opens it, does the steps, and writes what was found into the file."""

import contextlib
import dataclasses
import datetime
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from hil.addons.identify.commission.commission_findings import Findings
from hil.addons.identify.commission.commission_session import Session
from hil.addons.identify.commission.person import Onlooker, Person, Terminal
from hil.addons.identify.commission.procedure import Procedure
from hil.core.errors import BadInputError, HilError
from hil.core.options import format_value
from hil.core.outputs import write_whole
from hil.core.types import WHEEL_NAMES
from hil.core.wheel_map import IMU_AXES
from hil.robot.parameters import ParameterClient
from hil.runtime.robots import link_of, wiring
from hil.scenario import BASE, Scenario, load
from hil.scenario.commission import CommissionTable
from hil.scenario.motor_checks import make_driver
from hil.scenario.toml_text import key_lines, parse
from hil.wire.device_lock import device_held

_MEANWHILE = {"speed_kp_n_m_s_rad": 0.0, "speed_ki_n_m_rad": 0.0, "encoder_fault_s": 1.0}
"""Of the firmware while a robot is commissioned: no loop is closed, and no encoder is judged by the other three."""

_HEADER = re.compile(r"\s*\[")


def changed(text: str, values: Mapping[str, object], name: str = "file") -> str:
    """Return a TOML text with these values, by dotted keys of two parts; None removes the key.

    A key that is there is replaced in its line and keeps its comment; a new one is added at the end of its table, and a
    new table at the end of the text. Raises BadInputError for a text that is not TOML, and for a value that cannot be
    replaced.
    """
    for key, value in values.items():
        table, _, last = key.partition(".")
        text = _with(text, table, last, value)
    document = parse(text, name)
    for key, value in values.items():
        table, _, last = key.partition(".")
        there = document.get(table, {}).get(last)
        if there != (list(value) if isinstance(value, tuple) else value):
            raise BadInputError(f"{name}: {key} cannot be set to {format_value(value)}; write it there yourself")
    return text


def _write_values(path: Path, values: Mapping[str, object]) -> None:
    """Change values of a robot's file on disk, wholly or not at all. Raises BadInputError as ``changed``."""
    text = path.read_text(encoding="utf-8")
    write_whole(path, changed(text, values, str(path)).encode(), "robot file", "replace")


def _with(text: str, table: str, key: str, value: object) -> str:
    lines = text.split("\n")
    at = key_lines(text).get((table, key))
    if at is not None:
        end = at
        while end < len(lines) and not _is_whole("\n".join(lines[at - 1 : end])):
            end += 1
        comment = re.search(r"(\s+#[^\"'\]]*)$", lines[end - 1])
        new = [] if value is None else [f"{key} = {format_value(value)}{comment.group(1) if comment else ''}"]
        return "\n".join([*lines[: at - 1], *new, *lines[end:]])
    if value is None:
        return text
    header = next((n for n, line in enumerate(lines) if re.match(rf"\s*\[\s*{re.escape(table)}\s*\]", line)), None)
    if header is None:
        return f"{text.rstrip()}\n\n[{table}]\n{key} = {format_value(value)}\n"
    end = next((n for n in range(header + 1, len(lines)) if _HEADER.match(lines[n])), len(lines))
    while (end > header + 1 and not lines[end - 1].strip()) or lines[end - 1].lstrip().startswith("#"):
        end -= 1
    return "\n".join([*lines[:end], f"{key} = {format_value(value)}", *lines[end:]])


def _is_whole(statement: str) -> bool:
    try:
        parse(statement, "")
    except BadInputError:
        return False
    return True


class Commissioned(NamedTuple):
    """The table that the robot's file has now, the values written with it, and the largest motions."""

    table: CommissionTable
    values: dict[str, object]
    furthest_m: float
    fastest_rad_s: float


def commission(
    file: Path,
    *,
    sets: Sequence[str] = (),
    link: str | None = None,
    anew: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> Commissioned:
    """Do the steps that are left, and keep each in the robot's file as soon as it is done.

    The person at the terminal is asked; for a virtual robot in this process its truth. ``anew`` forgets earlier
    findings. Raises BadInputError before anything is opened, StepError for a failed step, DeviceError and LinkError for
    a lost robot, RunInterruptedError when the person stops. Findings of finished steps are then in the file.
    """
    told, session_scenario = _scenarios(file, sets, link)
    url = link_of(session_scenario)
    # A real robot cannot use the findings of a virtual one, and a virtual one cannot use those of a real one.
    anew = anew or told.commission.virtual != url.is_within_process
    if told.commission.state == "done" and not anew:
        raise BadInputError(f"{file}: this robot is commissioned ({told.commission.date}); do it again with --anew")
    findings = Findings(imu=told.device.imu) if anew else Findings.kept(told.commission, told.device)
    with (
        device_held(url, f"hil commission {file}"),
        _without_speed_loop(session_scenario),
        contextlib.closing(Session(session_scenario)) as session,
    ):
        for warning in session.connect():
            say(f"warning: {warning}")
        say(f"robot: {session.firmware}")

        def save(step: str) -> None:
            findings.finish(step, datetime.date.today().isoformat(), session.firmware)  # noqa: DTZ011 - the user's own
            _write_values(file, findings.document())
            say(f"{step}: done, and written into {file}")

        # Until it is done, real motors are refused.
        findings.table = dataclasses.replace(findings.table, state="begun", virtual=url.is_within_process)
        _write_values(file, findings.document())
        Procedure(session, _person(session), findings, say, save).run()
        say(
            f"the furthest way of a wheel's rim in a pulse was {session.furthest_m * 100:.1f} cm, the largest speed "
            f"of a wheel {session.fastest_rad_s:.1f} rad/s"
        )
        return Commissioned(findings.table, dict(findings.values), session.furthest_m, session.fastest_rad_s)


def _scenarios(file: Path, sets: Sequence[str], link: str | None) -> tuple[Scenario, Scenario]:
    """Return the scenario as the robot's file tells it, and the one in which every output is just a number.

    Raises BadInputError for a board that closes the loops of the wheels itself: its outputs cannot be driven singly.
    """
    told = load(BASE, robot=file, set=[*sets, "expect=[]", "fault=[]"], link=link)
    if told.device.is_makers and make_driver(told).capabilities.is_twist:
        raise BadInputError(
            f'device.driver = "{told.device.driver}": hil commission does not take it, because this board closes the '
            "loops of the wheels itself and cannot drive one alone. Connect motors and encoders as its manual says, "
            'try it on blocks, and write state = "done" under [commission] in the robot\'s file'
        )
    if any(text.partition("=")[0].removeprefix("firmware.") in _MEANWHILE for text in sets):
        raise BadInputError(
            "--set of the speed loop's gains or of encoder_fault_s: commissioning sets them; leave it out"
        )
    mode = "lockstep" if link_of(told).is_within_process else "realtime"
    plain: dict[str, object] = {
        "controller.command": "torque",
        "controller.law": "pid",
        "controller.gains": {},
        "estimator.source": "odometry",
        **{f"firmware.{name}": value for name, value in _MEANWHILE.items()},
        "device.wheels": WHEEL_NAMES,
        "device.reversed": (),
        "device.imu": IMU_AXES,
    }
    if mode == "lockstep":  # the virtual robot is wired as its file says, if nothing says otherwise
        wheels, signs = told.plant.wiring.wheels or told.device.wheels, wiring(told).motors.sign_of_channel
        plain |= {
            "plant.wiring.wheels": wheels,
            "plant.wiring.reversed": [wheel for wheel, sign in zip(wheels, signs, strict=True) if sign < 0],
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
        return Terminal()

    def pose() -> object:
        fix = truth.poll()
        assert fix is not None
        return fix.pose

    return Onlooker(wiring(session.scenario), pose)
