"""``hil probe`` and ``hil jog``: what motors a robot has, and which wheel each of them turns."""

import sys
from typing import Annotated

import typer

from hil.cli.options import Json, LinkUrl, RobotFile, ScenarioName, Sets, end_in_order, print_json
from hil.core.errors import BadInputError, RunInterruptedError


def probe(
    link: Annotated[str, typer.Argument(metavar="LINK", help="serial:PATH or can:INTERFACE/CHANNEL")],
    driver: Annotated[str | None, typer.Option(metavar="NAME", help="look for this one only")] = None,
    as_json: Json = False,
) -> None:
    """Find out what motor controllers are on a bus or a port, and print a robot file for them.

    Nothing moves and nothing is written: it listens, and asks for versions. Exit 1 when nobody was found.
    """
    from hil.cli.probe import probe as look
    from hil.wire.device_lock import device_held
    from hil.wire.url import parse_link

    tell = (lambda _sentence: None) if as_json else (lambda sentence: print(f"# {sentence}", flush=True))
    with device_held(parse_link(link), f"hil probe {link}"):
        result = look(link, driver, tell)
    if as_json:
        print_json(
            {
                "found": [
                    {
                        "driver": answer.driver,
                        "link": answer.link,
                        "what": answer.found.sentences,
                        "motors": answer.found.motors,
                        "known": dict(answer.found.known),
                        "unknown": answer.found.unknown,
                    }
                    for answer in result.answers
                ],
                "strangers": {f"{number:#x}": count for number, count in result.strangers.items()},
                "not_asked": result.not_asked,
                "elsewhere": result.elsewhere,
            }
        )
        raise typer.Exit(0 if result.answers else 1)
    if result.not_asked is not None:
        print(f"# {result.not_asked}")
    for answer in result.answers:
        for sentence in answer.found.sentences:
            print(f"# {sentence}")
        if answer.robot_file is None:
            print(
                f"# that is no whole robot with four motors; see DIALECTS.md for [device.motors] of {answer.driver!r}"
            )
        else:
            print(f"# {answer.wiring}")
            print(answer.robot_file)
    if result.strangers:
        ids = ", ".join(f"{number:#x}" for number in sorted(result.strangers))
        print(f"# {sum(result.strangers.values())} frames came of others, with the ids {ids}")
    if not result.answers:
        print("# nobody was found; check power, cable, and the link's bit rate or baud")
        if result.elsewhere is not None:
            print(f"# {result.elsewhere}")
    raise typer.Exit(0 if result.answers else 1)


def jog(
    scenario: ScenarioName,
    wheel: Annotated[str, typer.Argument(metavar="fl|fr|rr|rl")],
    link: LinkUrl = None,
    robot: RobotFile = None,
    speed_rad_s: Annotated[float, typer.Option("--speed", metavar="RAD/S", help="at most 3, either way")] = 1.0,
    seconds: Annotated[float, typer.Option(metavar="S", help="at most 10")] = 3.0,
    sets: Sets = None,
    as_json: Json = False,
) -> None:
    """Turn one wheel slowly, with its name typed first, to check order and direction of the motors.

    Put the robot on blocks, so that no wheel touches the ground. The exit code is 1 where the wheels' sensors saw
    something else than this wheel turning this way.
    """
    from hil.cli import report
    from hil.cli.jog import check
    from hil.cli.jog import jog as turn
    from hil.scenario import load
    from hil.wire.device_lock import device_held
    from hil.wire.opening import is_within_process
    from hil.wire.url import parse_link

    end_in_order()
    changes = [*(sets or []), "controller.command=speed", "controller.law=pid", "fault=[]", "expect=[]"]
    # Where the robot is nobody has to know.
    changes.append("estimator.source=odometry")
    resolved = load(scenario, set=changes, robot=robot, link=link)
    if not is_within_process(parse_link(resolved.link.url)):
        resolved = load(scenario, set=changes, robot=robot, link=link, mode="realtime")
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
            done = turn(resolved, wheel, speed_rad_s, seconds, report.warn)
    except KeyboardInterrupt:
        raise RunInterruptedError("interrupted; the wheel was told to stop") from None
    is_as_told, sentence = done.verdict(wheel)
    if as_json:
        print_json({"asked_rad": done.asked_rad, "turned_rad": done.turned_rad._asdict(), "verdict": sentence})
    else:
        angles = ", ".join(f"{name} {angle:+.2f}" for name, angle in done.turned_rad._asdict().items())
        print(f"asked {wheel} {done.asked_rad:+.2f} rad; the sensors saw {angles} rad")
        print(sentence)
    raise typer.Exit(0 if is_as_told else 1)
