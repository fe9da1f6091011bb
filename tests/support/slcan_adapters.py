"""Emulated slcan adapters on one emulated bus: what LAWICEL's protocol says, over real pseudo-terminals."""

import contextlib
import os
import select
import threading
import tty

BIT_RATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
_OK, _BELL = b"\r", b"\a"
_TRANSMIT = {ord("t"): b"z\r", ord("r"): b"z\r", ord("T"): b"Z\r", ord("R"): b"Z\r"}


def _say(descriptor: int, data: bytes) -> None:
    """Tell a host something; one that does not read loses it, as from an adapter whose buffer is full."""
    with contextlib.suppress(BlockingIOError):
        os.write(descriptor, data)


class _Adapter:
    def __init__(self) -> None:
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        os.set_blocking(self.master, False)
        self.port = os.ttyname(self.slave)
        self.bit_rate: int | None = None
        self.is_open = False
        self.line = b""


class SlcanBus:
    """So many adapters, each with the ``ports`` of its host's side. Frames reach the others of the same bit rate.

    ``filler`` is sent to a host before each of its frames, as an adapter's status reports are.
    """

    def __init__(self, adapters: int, filler: bytes = b"") -> None:
        self._adapters = [_Adapter() for _ in range(adapters)]
        self._filler = filler
        self.ports = [adapter.port for adapter in self._adapters]
        self._woken, self._wake = os.pipe()
        self._opened = threading.Condition()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        by_descriptor = {adapter.master: adapter for adapter in self._adapters}
        while self._woken not in (ready := select.select([*by_descriptor, self._woken], [], [])[0]):
            for descriptor in ready:
                adapter = by_descriptor[descriptor]
                *lines, adapter.line = (adapter.line + os.read(descriptor, 65536)).split(b"\r")
                for line in lines:
                    _say(descriptor, self._answer(adapter, line))

    def _answer(self, adapter: _Adapter, line: bytes) -> bytes:
        command, rest = line[:1], line[1:]
        if command == b"S" and not adapter.is_open and rest.isdigit() and int(rest) < len(BIT_RATES):
            adapter.bit_rate = BIT_RATES[int(rest)]
            return _OK
        if command in (b"O", b"L") and adapter.bit_rate is not None:
            with self._opened:
                adapter.is_open = True
                self._opened.notify_all()
            return _OK
        if command == b"C":
            adapter.is_open = False
            return _OK
        if line and line[0] in _TRANSMIT and adapter.is_open:
            for other in self._adapters:
                if other is not adapter and other.is_open and other.bit_rate == adapter.bit_rate:
                    _say(other.master, self._filler + line + b"\r")
            return _TRANSMIT[line[0]]
        return _BELL

    def wait_until_open(self) -> None:
        """Return when all adapters are on the bus: python-can does not wait for their answers."""
        with self._opened:
            assert self._opened.wait_for(lambda: all(adapter.is_open for adapter in self._adapters), 10.0)

    def say(self, number: int, data: bytes) -> None:
        """Have an adapter send these bytes to its host."""
        _say(self._adapters[number].master, data)

    def close(self) -> None:
        os.write(self._wake, b"x")
        self._thread.join()
        for adapter in self._adapters:
            os.close(adapter.master)
            os.close(adapter.slave)
        os.close(self._wake)
        os.close(self._woken)
