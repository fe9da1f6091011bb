"""``hil probe``: whom it hears, whom it then queries and what it prints. Time passes only while it waits for frames."""

import contextlib
import json
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import pytest

from firmware_protocol import codec
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.addons.motors.probe_command import find_motors
from hil.core.errors import BadInputError
from hil.core.link_protocol import LinkProtocol
from hil.core.ports import Link, Received
from hil.robot.driver_registry import dialect, driver_names
from hil.robot.virtual import new_robot
from hil.runtime.robots import node_maker, virtual_robot
from hil.scenario import load
from hil.wire.can_url import CanUrl
from hil.wire.framed import StreamLink
from hil.wire.serial_url import SerialUrl
from tests.support.processes import hil

TICK_NS = 1_000_000
CAN, CAN_FD, LINE = "can:socketcan/probed", "can:socketcan/probed?fd=1", "serial:/dev/ttyProbed"


class Scene:
    """A line or a bus with emulated devices, and frames of others that come at times [ms]."""

    def __init__(self, nodes: Sequence[Any] = (), others: Mapping[int, Frame | bytes] | None = None) -> None:
        self.nodes, self.others = nodes, dict(others or {})
        self.now_ns = 0
        self.sent: list[Frame] = []
        self.sent_bytes = b""
        self.written_ns: list[int] = []
        self.opened: list[str] = []
        self.is_open = False

    def open(self, url: Any, protocol: LinkProtocol) -> Link:
        assert not self.is_open
        self.opened.append(str(url))
        self.is_open = True
        link: Any = self if url.is_bus else StreamLink(Stream(self), protocol)
        return link

    def until(self, timeout_ns: int, arrived: Callable[[], Any]) -> Any:
        """Let time pass until something has arrived, at most so long."""
        end_ns = self.now_ns + max(timeout_ns, 0)
        while self.now_ns < end_ns:
            self.now_ns = min(self.now_ns + TICK_NS, end_ns)
            for node in self.nodes:
                node.run(1)
            if data := arrived():
                return data
        return None

    def _others(self) -> list[Any]:
        return [self.others.pop(t_ms) for t_ms in sorted(self.others) if t_ms * TICK_NS <= self.now_ns]

    # As a bus

    def receive(self, timeout_ns: int) -> Received | None:
        def arrived() -> list[Frame]:
            return [*self._others(), *(frame for node in self.nodes for frame in node.take_frames())]

        frames = self.until(timeout_ns, arrived)
        return Received(frames, self.now_ns) if frames else None

    def send(self, frame: Frame) -> None:
        self.sent.append(frame)
        for node in self.nodes:
            node.receive(frame)

    def close(self) -> None:
        self.is_open = False


class Stream:
    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def read(self, timeout_ns: int) -> bytes:
        scene = self._scene
        found = scene.until(timeout_ns, lambda: b"".join([*scene._others(), *(n.take_bytes() for n in scene.nodes)]))
        return found or b""

    def write(self, data: bytes) -> None:
        self._scene.sent_bytes += data
        self._scene.written_ns.append(self._scene.now_ns)
        for node in self._scene.nodes:
            node.feed(data)

    def close(self) -> None:
        self._scene.close()


@pytest.fixture
def play(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[Scene], Scene]]:
    """Put a scene at the other end of every link."""

    def begin(scene: Scene) -> Scene:
        def open_host(url: Any, *_line: Any, protocol: LinkProtocol) -> Link:
            return scene.open(url, protocol)

        monkeypatch.setattr(CanUrl, "open_host", open_host)
        monkeypatch.setattr(SerialUrl, "open_host", open_host)
        monkeypatch.setattr(time, "monotonic_ns", lambda: scene.now_ns)
        return scene

    with monkeypatch.context():
        yield begin
        monkeypatch.undo()


@contextlib.contextmanager
def devices(driver: str, **changes: Any) -> Iterator[Any]:
    scenario = load("circle_speed", mode="lockstep", set={"device.driver": driver} | changes)
    with new_robot(virtual_robot(scenario), node_maker(scenario.device)) as robot:
        yield robot.node


def asked(said: Sequence[str]) -> list[str]:
    return [sentence.removeprefix("asking for ") for sentence in said if sentence.startswith("asking for ")]


def titles(fits: Callable[[Any], bool]) -> list[str]:
    """Return what is queried on a silent line, in order."""
    return [dialect(name).title for name in driver_names() if name != "stm32" and fits(dialect(name))]


C620 = {10 + 7 * number: Frame(0x200 + number, bytes([0, number, 0, 0, 0, 0, 25, 0])) for number in (1, 3, 4, 8)}
STRANGERS = {20: Frame(0x123, b"\x01"), 450: Frame(0x123, b"\x02"), 599: Frame(0x0F5, b"")}


def test_who_is_heard_is_found_without_a_question_and_the_rest_are_strangers(play: Any) -> None:
    scene = play(Scene(others=C620 | STRANGERS))
    ran = hil("probe", CAN, "--json")
    assert ran.returncode == 0
    assert json.loads(ran.stdout) == {
        "found": [
            {
                "driver": "c620",
                "link": CAN,
                "what": [f"a C620 or C610 with the id {number}" for number in (1, 3, 4, 8)],
                "motors": {"ids": [1, 3, 4, 8]},
                "known": {},
                "unknown": ["device.motors.controller", "device.motors.gear_ratio", "firmware.torque_constant_n_m_a"],
            }
        ],
        "strangers": {"0x123": 2, "0xf5": 1},
        "not_asked": None,
    }
    assert scene.sent == []
    assert scene.opened == [CAN]
    assert not scene.is_open
    assert scene.now_ns == 600 * TICK_NS


def test_what_is_found_is_printed_as_a_robot_file(play: Any) -> None:
    play(Scene(others=C620 | STRANGERS))
    ran = hil("probe", CAN)
    lines = ran.stdout.splitlines()
    assert lines[:2] == ["# listening for 0.6 s", "# asking for RoboMaster C620 and C610"]
    assert lines[2:6] == [f"# a C620 or C610 with the id {number}" for number in (1, 3, 4, 8)]
    assert "cannot be queried: see hil commission" in lines[6]
    assert lines[-1] == "# 3 frames are of unknown senders, with the ids 0xf5, 0x123"
    robot = tomllib.loads(ran.stdout)
    assert (robot["device"]["driver"], robot["device"]["motors"]["ids"]) == ("c620", [1, 3, 4, 8])
    assert robot["link"]["url"] == CAN


def test_motors_that_are_no_whole_robot_are_told_without_a_file(play: Any) -> None:
    play(Scene(others={t: C620[t] for t in (17, 38)}))
    ran = hil("probe", CAN, "--driver", "c620")
    assert ran.returncode == 0
    assert ran.stdout.splitlines()[2:] == [
        "# a C620 or C610 with the id 1",
        "# a C620 or C610 with the id 4",
        "# this is not a whole robot with four motors; see DRIVERS.md for [device.motors] of 'c620'",
    ]


@pytest.mark.parametrize(
    ("link", "fits"),
    [
        (CAN, lambda made: made.probe is not None and "can" in made.wires),
        (CAN_FD, lambda made: made.probe is not None and "can_fd" in made.wires),
        (LINE, lambda made: (made.serial_probe or made.probe) is not None and "serial" in made.wires),
    ],
    ids=["can", "can fd", "line"],
)
def test_on_a_silent_line_each_kind_is_queried_in_turn(play: Any, link: str, fits: Callable[[Any], bool]) -> None:
    scene, said = play(Scene()), list[str]()
    result = find_motors(link, say=said.append)
    ours = ["our own firmware"] if "stm32" in driver_names() else []
    assert sorted(asked(said)) == sorted([*ours, *titles(fits)])
    assert result.answers == []
    assert result.not_queried is None
    [told] = result.lines()
    assert told.startswith("# no motor controllers were found; check power, cable, and the link's bit rate or baud")
    hello = codec.encode(m.HelloRequest(m.PROTOCOL_VERSION))
    if link != LINE:
        assert scene.sent.count(hello) == 2
        assert said[0] == "listening for 0.6 s"
    else:
        bauds = {url.partition("baud=")[2] for url in scene.opened}
        assert bauds == {"", "115200"}
        assert [one.partition(" on ")[0].removeprefix("listening for ") for one in said[: len(said) // 2]] == asked(
            said
        )


def test_where_only_strangers_speak_nobody_is_queried_unless_named(play: Any) -> None:
    scene = play(Scene(others=STRANGERS))
    ran = hil("probe", CAN)
    assert ran.returncode == 1
    assert "# 3 frames came of unknown senders, so no motor controller was queried" in ran.stdout
    assert "# no motor controllers were found" in ran.stdout
    assert scene.sent == []
    scene, said = play(Scene(others=STRANGERS)), list[str]()
    result = find_motors(CAN, "odrive", said.append)
    assert result.not_queried is None
    assert result.strangers == {0x123: 2, 0x0F5: 1}
    assert asked(said) == ["ODrive"]


def test_bytes_that_nobody_understands_are_left_without_an_answer_unless_one_is_named(play: Any) -> None:
    scene = play(Scene(others=dict.fromkeys(range(0, 2000, 300), b"$GPGGA\r\n")))
    result = find_motors(LINE)
    assert (result.not_queried or "").startswith("56 bytes came of unknown senders")
    assert scene.sent_bytes == b""
    scene, said = play(Scene(others={5: b"$GPGGA\r\n"})), list[str]()
    assert find_motors(LINE, "rosmaster", said.append).not_queried is None
    assert asked(said) == ["Yahboom Rosmaster"]
    asked_ms = sorted({t_ns // TICK_NS for t_ns in scene.written_ns})
    assert asked_ms == [600, 700, 800, 900, 1000], "five rounds, each a tenth of a second for an answer"


def test_odrives_that_were_heard_are_queried_and_nobody_else_is(play: Any) -> None:
    with devices("odrive", **{"device.motors.node_ids": [17, 18, 21, 30]}) as node:
        scene, said = play(Scene([node], STRANGERS)), list[str]()
        result = find_motors(CAN, say=said.append)
    [answer] = result.answers
    assert (answer.driver, answer.link, answer.found.motors) == ("odrive", CAN, {"node_ids": [17, 18, 21, 30]})
    assert asked(said) == ["ODrive"]
    assert result.strangers == {0x123: 2, 0x0F5: 1}
    assert {frame.id >> 5 & 0x3F for frame in scene.sent} == {17, 18, 21, 30}


def test_our_own_firmware_on_a_bus_is_the_only_answer(play: Any) -> None:
    """Its frames look like those of an ODrive, which is not queried; and it is asked for two pages at most."""
    with devices("stm32", **{"robot.half_length_m": 0.31, "robot.half_width_m": 0.22}) as node:
        scene, said = play(Scene([node], STRANGERS)), list[str]()
        result = find_motors(CAN, say=said.append)
    [answer] = result.answers
    assert answer.driver == "stm32"
    assert answer.found.sentences[0].startswith("our own firmware: firmware ")
    assert answer.found.known == {
        "robot.wheel_radius_m": 0.075,
        "robot.half_length_m": pytest.approx(0.31, abs=2e-4),
        "robot.half_width_m": pytest.approx(0.22, abs=2e-4),
        "firmware.counts_per_revolution": 4096,
    }
    assert asked(said) == ["our own firmware"]
    assert scene.sent == [codec.encode(m.HelloRequest(m.PROTOCOL_VERSION))]
    assert 690 * TICK_NS < scene.now_ns < 750 * TICK_NS, "it waits for the status, which comes ten times a second"
    assert result.strangers == {0x123: 2, 0x0F5: 1}


def test_the_board_that_speaks_on_a_line_ends_the_search(play: Any) -> None:
    with devices("rosmaster", **{"plant.start.battery_voltage_v": 12.0}) as node:
        scene, said = play(Scene([node])), list[str]()
        result = find_motors(LINE, say=said.append)
    [answer] = result.answers
    assert (answer.driver, answer.link) == ("rosmaster", f"{LINE}?baud=115200")
    assert asked(said) == ["Yahboom Rosmaster"]
    assert said[-2].startswith("listening for Yahboom Rosmaster on ")
    assert result.strangers == {}
    assert not scene.is_open


def test_a_link_to_nothing_outside_is_refused() -> None:
    with pytest.raises(BadInputError, match="'memory:' reaches nothing outside this process; name a port or a bus"):
        find_motors("memory:")
