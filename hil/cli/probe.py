"""``hil probe``: prints the motor controllers on a bus or a port, and a robot file for them."""

from typing import Annotated

import typer

from hil.cli.find_motors import Result, find_motors
from hil.cli.options import Json, print_json
from hil.wire.device_lock import device_held
from hil.wire.url import parse_link


def probe(
    link: Annotated[str, typer.Argument(metavar="LINK", help="serial:PATH or can:INTERFACE/CHANNEL")],
    driver: Annotated[str | None, typer.Option(metavar="NAME", help="look for this one only")] = None,
    as_json: Json = False,
) -> None:
    """Find the motor controllers on a bus or a port, and print a robot file for them.

    Nothing moves and nothing is written: it listens, and asks for versions. Exit 1 when nothing was found.
    """
    with device_held(parse_link(link), f"hil probe {link}"):
        result = find_motors(link, driver, (lambda _: None) if as_json else _say)
    if as_json:
        print_json(result.record())
    else:
        _print(result)
    raise typer.Exit(0 if result.answers else 1)


def _say(sentence: str) -> None:
    """Print a comment of the robot file."""
    print(f"# {sentence}", flush=True)


def _print(result: Result) -> None:
    if result.not_queried is not None:
        _say(result.not_queried)
    for answer in result.answers:
        for sentence in answer.found.sentences:
            _say(sentence)
        if answer.robot_file is None:
            _say(f"this is not a whole robot with four motors; see DRIVERS.md for [device.motors] of {answer.driver!r}")
        else:
            _say(answer.wiring)
            print(answer.robot_file)
    if result.strangers:
        ids = ", ".join(f"{number:#x}" for number in sorted(result.strangers))
        _say(f"{sum(result.strangers.values())} frames are of unknown senders, with the ids {ids}")
    if not result.answers:
        _say("no motor controllers were found; check power, cable, and the link's bit rate or baud")
        if result.elsewhere is not None:
            _say(result.elsewhere)
