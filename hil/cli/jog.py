"""``hil jog``: turns one wheel slowly, to check that it is the right one and turns the right way."""

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer
from typer import Argument, Option

from hil.cli.options import Json, LinkUrl, RobotFile, ScenarioName, Sets, load_scenario
from hil.cli.output import end_in_order, print_result, warn
from hil.core.errors import BadInputError, DeviceError, RunInterruptedError
from hil.core.types import WHEEL_NAMES, ZERO_WHEELS, CommandMode, WheelCommand, Wheels

if TYPE_CHECKING:
    from hil.core.model import RobotModel
    from hil.scenario import Scenario

MOST_RAD_S = 3.0
MOST_S = 10.0
_RAMP_S = 0.5
_STOP_LIMIT_NS = 5_000_000_000
_LEAST_SHARE = 0.1  # of the commanded angle
_LEAST_RAD = 0.1  # enough in any case; on the ground, with three wheels held, a wheel may stall after twice as much
_FREE_SHARE = 0.5  # of the commanded angle, for a wheel that nothing brakes
_MOST_SHARE = 0.5
_SHORT = ", but not far: the wheels stand on the ground, as a virtual robot's always do, or something brakes it"


def jog(
    scenario: ScenarioName,
    wheel: Annotated[str, Argument(metavar="fl|fr|rr|rl")],
    link: LinkUrl = None,
    robot: RobotFile = None,
    speed_rad_s: Annotated[float, Option("--speed", metavar="RAD/S", help="at most 3, either way")] = 1.0,
    seconds: Annotated[float, Option("--for", metavar="S", help="at most 10")] = 3.0,
    sets: Sets = None,
    as_json: Json = False,
) -> None:
    """Turn one wheel slowly, with its name typed first, to check order and direction of the motors.

    Put the robot on blocks, so that no wheel touches the ground. The exit code is 1 where the wheels' sensors saw
    something else than this wheel turning this way.
    """
    from hil.wire.device_lock import device_held
    from hil.wire.url import parse_link

    end_in_order()
    changes = [*(sets or []), "controller.command=speed", "controller.law=pid", "fault=[]", "expect=[]"]
    changes.append("estimator.source=odometry")  # the pose does not matter
    resolved = load_scenario(scenario, set=changes, robot=robot, link=link)
    if not parse_link(resolved.link.url).is_within_process:
        resolved = load_scenario(scenario, set=changes, robot=robot, link=link, mode="realtime")
    check(resolved, wheel, speed_rad_s, seconds)
    way = "forward" if speed_rad_s > 0 else "backward"
    print(
        f"The wheel {wheel} will turn {way} at {abs(speed_rad_s):g} rad/s for {seconds:g} s.\n"
        f"All wheels must be off the ground. Type {wheel} and Enter to turn it: ",
        end="",
        file=sys.stderr,
        flush=True,
    )
    if sys.stdin.readline().strip() != wheel:
        raise BadInputError(f"{wheel!r} was not typed; nothing was sent")
    try:
        with device_held(parse_link(resolved.link.url), f"hil jog {resolved.name} {wheel}"):
            done = turn_wheel(resolved, wheel, speed_rad_s, seconds, warn)
    except KeyboardInterrupt:
        raise RunInterruptedError("interrupted; the wheel was told to stop") from None
    is_right, sentence = done.verdict(wheel)
    turned_rad = done.turned_rad._asdict()
    angles = ", ".join(f"{name} {angle:+.2f}" for name, angle in turned_rad.items())
    text = f"asked {wheel} {done.requested_rad:+.2f} rad; the sensors saw {angles} rad\n{sentence}"
    found = {"asked_rad": done.requested_rad, "turned_rad": turned_rad, "verdict": sentence}
    print_result(as_json, found, [text])
    raise typer.Exit(0 if is_right else 1)


class Jogged(NamedTuple):
    """Commanded angle of the chosen wheel, and the angles of all wheels by their own sensors [rad]."""

    requested_rad: float
    turned_rad: Wheels

    def verdict(self, wheel: str) -> tuple[bool, str]:
        """Return whether the sensor of the wheel alone moved, and in the right direction; with a sentence on it.

        Only a person can see whether the wheel that turned is the named one.
        """
        turned = dict(zip(WHEEL_NAMES, self.turned_rad, strict=True))
        enough = min(_LEAST_SHARE * abs(self.requested_rad), _LEAST_RAD)
        least = max(enough, _MOST_SHARE * max(map(abs, self.turned_rad)))
        moved = [name for name, angle in turned.items() if abs(angle) > least]
        if moved == [wheel]:
            if turned[wheel] * self.requested_rad > 0.0:
                short = "" if abs(turned[wheel]) >= _FREE_SHARE * abs(self.requested_rad) else _SHORT
                seen = f"the sensor of {wheel} followed{short}; if you saw it turn the right way, its wiring is right"
                return True, seen
            what = f"the sensor of {wheel} counted the other way; put {wheel!r} into device.reversed, or take it out"
        elif not moved:
            what = f"no sensor saw a wheel turn; check the motor's power, and its encoder's cable, of {wheel}"
        else:
            what = f"{wheel} was to turn, and the sensors of {', '.join(moved)} saw it; correct device.wheels"
        return False, what


def turn_wheel(
    scenario: "Scenario", wheel: str, speed_rad_s: float, seconds: float, warn: Callable[[str], None] = lambda _: None
) -> Jogged:
    """Turn a wheel for ``seconds`` with ramps of 0.5 s at both ends, and stop.

    ``warn`` gets the warnings of the driver before anything moves. In any case the robot is told to stop. Raises
    BadInputError for a wheel or a number out of range and for a controller that takes body velocities, DeviceError and
    LinkError when the robot refuses, stops or is lost.
    """
    from hil.runtime.bench import Bench
    from hil.runtime.freshness import Freshness
    from hil.runtime.sampling import Timing

    check(scenario, wheel, speed_rad_s, seconds)
    period_ns = scenario.loop.period_ns
    stale_ns = round(scenario.firmware.watchdog_s * 1e9)
    with Bench(scenario, None, allow_motion=True, wiring_is_unknown=True) as bench:
        device = bench.device
        bench.connect()
        for sentence in device.warnings:
            warn(sentence)
        speed_rad_s = _limited(scenario.robot, device.speed_limit_rad_s, speed_rad_s, warn)
        begin_ns = device.start(bench.clock, period_ns)
        freshness = Freshness(bench.clock, device, None, Timing(period_ns, 0, 0, stale_ns))
        turned = [0.0] * 4
        try:
            for n in range(1, 1 + round(seconds * 1e9) // period_ns):
                device.wait_until(begin_ns + n * period_ns)
                t_s = n * period_ns * 1e-9
                feedback = freshness.poll(t_s)
                share = max(0.0, min(t_s / _RAMP_S, 1.0, (seconds - t_s) / _RAMP_S))
                if freshness.is_silent():
                    raise DeviceError(
                        f"the feedback is {freshness.silent_ns * 1e-6:.0f} ms old; the wheel was told to stop, but "
                        "nothing confirms it: cut the motors' power if it turns"
                    )
                speed = Wheels(*(share * speed_rad_s if name == wheel else 0.0 for name in WHEEL_NAMES))
                device.send(WheelCommand(CommandMode.SPEED, speed, ZERO_WHEELS))
                turned = [a + s * period_ns * 1e-9 for a, s in zip(turned, feedback.speed_rad_s, strict=True)]
        finally:
            is_still = device.stop(period_ns, _STOP_LIMIT_NS)
    if not is_still:
        raise DeviceError("the robot did not come to rest within 5 s; cut the motors' power")
    return Jogged(speed_rad_s * (seconds - _RAMP_S), Wheels(*turned))


def _limited(model: "RobotModel", robot_rad_s: float, speed_rad_s: float, warn: Callable[[str], None]) -> float:
    """Return the speed, limited by the guard."""
    from hil.core.guard import Guard

    guard = Guard(model.speed_limit_rad_s, model.torque_limit_n_m)
    guard.limit_to(robot_rad_s)
    command = WheelCommand(CommandMode.SPEED, ZERO_WHEELS._replace(fl=speed_rad_s), ZERO_WHEELS)
    limited, is_scaled = guard.apply(command)
    if is_scaled:
        warn(f"the wheel turns at {limited.speed_rad_s.fl:.4g} rad/s, the limit, and not at {speed_rad_s:g}")
    return limited.speed_rad_s.fl


def check(scenario: "Scenario", wheel: str, speed_rad_s: float, seconds: float) -> None:
    """Raise BadInputError for arguments that ``turn_wheel`` refuses, before anything is opened."""
    from hil.scenario.motors import make_driver

    if wheel not in WHEEL_NAMES:
        raise BadInputError(f"wheel {wheel!r}: expected one of {', '.join(WHEEL_NAMES)}")
    if not 0.0 < abs(speed_rad_s) <= MOST_RAD_S:
        raise BadInputError(f"speed {speed_rad_s:g} rad/s: expected at most {MOST_RAD_S:g} either way, and not zero")
    if not 2 * _RAMP_S < seconds <= MOST_S:
        raise BadInputError(f"{seconds:g} s: expected more than {2 * _RAMP_S:g}, at most {MOST_S:g}")
    if scenario.controller.mode is not CommandMode.SPEED:
        raise BadInputError("a wheel is turned by its speed: add --set controller.command=speed")
    if scenario.device.is_makers and make_driver(scenario).capabilities.is_twist:
        raise BadInputError(
            f"{scenario.device.driver!r} takes body velocities and sets all wheel speeds itself; put the wheels off "
            "the ground and drive it with hil serve and hil teleop"
        )
