"""The boards of ``hil device --target``: found by name, this package's and others'."""

from pathlib import Path

import pytest

from hil.core import extensions
from hil.core.errors import BadInputError
from hil.robot.boards import find_board
from hil.robot.virtual import VirtualStm32
from hil.runtime.robots import virtual_robot
from hil.scenario import load
from hil.wire.url import parse_link
from tests.support.outside import outside_package

OTHERS = """
    from hil.robot.boards import Board
    from hil.robot.virtual import VirtualStm32

    BOARD = Board(lambda made_of, url: VirtualStm32(made_of), plant_baud=9600)
    OPEN = BOARD.open
"""


@pytest.fixture(autouse=True)
def others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = {"theirs": "outside_package:BOARD", "host": "outside_package:BOARD", "wrong": "outside_package:OPEN"}
    outside_package(tmp_path, monkeypatch, OTHERS, {"hil.boards": names})


def test_the_firmware_runs_in_this_process_or_on_another_packages_board() -> None:
    assert find_board("theirs").plant_baud == 9600
    assert find_board("host").plant_baud is None
    robot = find_board("host").open(virtual_robot(load("paper_circle")), parse_link("memory:"))
    assert type(robot) is VirtualStm32
    robot.close()


def test_what_cannot_be_used_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BadInputError, match=r"^--target 'their': there is no such target; did you mean 'theirs'\?$"):
        find_board("their")
    with pytest.raises(BadInputError, match=r"^--target 'wrong': .* is no hil\.robot\.boards\.Board$"):
        find_board("wrong")
    monkeypatch.setattr(extensions, "is_installed", lambda place: not place.startswith("hil.addons.targets"))
    with pytest.raises(BadInputError, match=r"^--target 'qemu': it belongs to hil\.addons\.targets, which is not inst"):
        find_board("qemu")
