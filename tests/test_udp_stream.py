"""The stream over UDP, into a real receiver: every signal, cut into datagrams, and nothing that a tick waits for."""

import json
import math
import os
import signal
import socket
import threading
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

import hil
from hil.core.errors import BadInputError
from hil.core.signals import SIGNAL_NAMES, pack_row
from hil.record.udp import MOST_BYTES, DatagramWriter, UdpStream, parse_destination
from tests.examples import share_of_examples
from tests.recorded_circle import circle_rows

SHORT = {"loop.duration_s": 0.5, "loop.rate_hz": 200, "expect": []}
posix_only = pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")


class Receiver:
    """Keeps what arrives at a free port, until ``stop``."""

    def __init__(self) -> None:
        self.datagrams: list[bytes] = []
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self._socket.bind(("127.0.0.1", 0))
        self.url = f"udp://127.0.0.1:{self._socket.getsockname()[1]}"
        self._thread = threading.Thread(target=self._receive, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Take what was sent so far, and end: loopback keeps the order."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as last:
            last.sendto(b"", self._socket.getsockname())
        self._thread.join()
        self._socket.close()

    def _receive(self) -> None:
        while datagram := self._socket.recv(1 << 16):
            self.datagrams.append(datagram)


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    yield (one := Receiver())
    if one._thread.is_alive():
        one.stop()


def no_constant(name: str) -> float:
    raise AssertionError(f"{name} is no JSON")


def numbers(datagram: bytes) -> dict[str, float | None]:
    """What PlotJuggler makes of a datagram: a series for each number, by the names on the way to it."""

    def below(tree: dict, path: str) -> Iterator[tuple[str, float | None]]:
        for name, value in tree.items():
            if isinstance(value, dict):
                yield from below(value, f"{path}{name}.")
            else:
                yield f"{path}{name}", value

    return dict(below(json.loads(datagram, parse_constant=no_constant), ""))


def test_every_signal_of_a_run_arrives_a_hundred_times_a_second(receiver: Receiver) -> None:
    """Also the extra ones of a law and a shadow, and without a recording."""
    result = hil.run("paper_circle", set=SHORT | {"controller.shadow": ["dsc"]}, stream=receiver.url)
    receiver.stop()
    rows: dict[float, dict[str, float | None]] = {}
    for count, datagram in enumerate(receiver.datagrams):
        assert len(datagram) <= MOST_BYTES
        found = numbers(datagram)
        assert found.pop("sequence") == count
        rows.setdefault(found.pop("timestamp"), {}).update(found)
    assert result.metrics["streamed"]["sent"] == len(receiver.datagrams)
    assert result.metrics["streamed"]["lost"] == 0
    assert list(rows) == list(result.signals["loop.t_s"][::2])
    for place, row in enumerate(rows.values()):
        assert row.keys() == result.signals.keys()
        for name, value in row.items():
            expected = result.signals[name][2 * place]
            assert value == expected or (value is None and math.isnan(expected)), name


@share_of_examples(0.25)
@given(st.lists(st.floats(), min_size=len(SIGNAL_NAMES), max_size=len(SIGNAL_NAMES)), st.booleans())
def test_whatever_the_values_a_datagram_is_json_and_fits_a_frame(row: list[float], many: bool) -> None:
    names = [*SIGNAL_NAMES, *(f"shadow.A{i}.wheel.fl.torque_command_n_m" for i in range(40 * many))]
    writer = DatagramWriter(names)
    row = [1.0, *row[1:], *row[: 40 * many]]
    found: dict[str, float | None] = {}
    for datagram in writer.datagrams(row):
        assert len(datagram) <= MOST_BYTES
        piece = numbers(datagram)
        assert not set(piece) & set(found) - {"timestamp", "sequence"}
        found |= piece
    assert found.keys() == {*names, "timestamp", "sequence"}
    for name, value in zip(names, row, strict=True):
        assert found[name] == value if math.isfinite(value) else found[name] is None


def test_where_nobody_listens_the_loss_is_counted_and_the_run_is_none_the_worse(receiver: Receiver) -> None:
    receiver.stop()  # the port is free now, and nobody else's within this moment
    result = hil.run("paper_circle", set=SHORT, stream=receiver.url)
    assert result.passed
    streamed = result.metrics["streamed"]
    assert (streamed["sent"], streamed["rows_dropped"]) == (0, 0)
    assert streamed["lost"] > 50
    assert streamed["error"] == "nobody listened there"


@posix_only
def test_a_tick_never_waits_for_a_sender_that_stands_still(receiver: Receiver) -> None:
    """More rows than the ring holds, put while the sender is stopped: they are dropped, and counted."""
    count, capacity = 20_000, 16_384
    row = next(circle_rows(1))
    with UdpStream(parse_destination(receiver.url), signals=SIGNAL_NAMES, blocking=False) as stream:
        os.kill(stream.pid, signal.SIGSTOP)
        for _ in range(count):
            stream.put(pack_row(row))
        os.kill(stream.pid, signal.SIGCONT)
        figures = stream.finish()
    assert figures["rows_dropped"] == count - capacity
    assert figures["sent"] > 0


@posix_only
def test_a_run_goes_on_when_the_sender_was_killed(receiver: Receiver) -> None:
    with UdpStream(parse_destination(receiver.url), signals=SIGNAL_NAMES, blocking=True) as stream:
        os.kill(stream.pid, signal.SIGKILL)
        for row in circle_rows(20_000):
            stream.put(pack_row(row))
        figures = stream.finish()
    assert figures["sent"] is None
    assert figures["error"].startswith("the sender of the stream ended before the run")


def test_without_a_host_it_stays_on_this_machine() -> None:
    assert parse_destination("udp://:9870") == parse_destination("udp://localhost:9870")
    assert parse_destination("udp://:9870") == ("127.0.0.1", 9870)
    assert parse_destination("udp://192.0.2.7:9870") == ("192.0.2.7", 9870)


@pytest.mark.parametrize("url", ["9870", "tcp://127.0.0.1:9870", "udp://127.0.0.1", "udp://pc:9870", "udp://:0", ""])
def test_an_address_that_is_none_is_refused_before_the_run(url: str) -> None:
    with pytest.raises(BadInputError, match=r"^--stream = .*; expected") as refusal:
        hil.run("paper_circle", set=SHORT, stream=url)
    assert "\n" not in str(refusal.value)
