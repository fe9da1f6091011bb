"""Serial ports by pyserial: device files, COM ports and pyserial's own URLs (``socket://``, ``rfc2217://``)."""

import contextlib
import re
import select
import threading
import time
from typing import Any

import serial

from firmware_protocol.built import BuildError
from firmware_protocol.extension import library, wheel
from hil.core.errors import BadInputError, LinkError
from hil.wire.reopening import OpeningBeside
from hil.wire.serial_failures import GONE, LIST_PORTS, PORT_ERRORS, is_gone, opening_problem, words_of

_CHUNK = 65536
_READ_S = 0.05  # how long one read of a Reader blocks, which is also how long it takes to stop
_LONGEST = 1 << 20  # bytes kept for a host that does not read
_WRITE_TIMEOUT_S = 1.0  # a line that accepts no byte for that long is lost
# re.error: from hwgrep://, which takes a pattern.
_OPENING_FAILURES: tuple[type[Exception], ...] = (
    serial.SerialException,
    ValueError,
    NotImplementedError,
    re.error,
    *PORT_ERRORS,
)
_LOSSES: tuple[type[Exception], ...] = (serial.SerialException, TypeError, *PORT_ERRORS)
_SERVERS = ("socket:", "rfc2217:")
_CONNECTING_S = 0.1  # enough for a server that answers; limits how long a service's tick waits

_QUIET_NS = 20_000_000


class Terminal:
    """Reads and writes a non-blocking terminal device with few system calls; pyserial does what that leaves.

    While there is nothing to read, ``select`` and ``read`` wait for a thread of the kernel without real-time priority,
    on a busy machine for milliseconds. So this asks first whether there is, in the host library, without waiting.

    Raises BadInputError when the library cannot be loaded.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        try:
            library()
        except BuildError as error:
            raise BadInputError(str(error)) from error
        self._quiet_until_ns = 0

    def write(self, data: bytes) -> int:
        """Return how many bytes were written; 0 when the line is full or lost."""
        return wheel.terminal_write(self._descriptor, data)

    def read(self) -> bytes | None:
        """Return the bytes that arrived; None after 20 ms of silence or on a lost line: pyserial's read shows which."""
        data = wheel.terminal_read(self._descriptor)
        if data:
            self._quiet_until_ns = 0
            return data
        now_ns = time.monotonic_ns()
        if not self._quiet_until_ns:
            self._quiet_until_ns = now_ns + _QUIET_NS
        return data if now_ns < self._quiet_until_ns else None


class Reader:
    """A thread that blocks in the port's own read, so that ``read`` can wait for any time.

    It is for ports that select cannot wait on: COM ports, and pyserial's URLs without a file descriptor. The port's
    timeout is set once: for RFC 2217 each change of it is a negotiation over the network. A port whose bytes nobody
    reads is lost.
    """

    def __init__(self, port: Any) -> None:
        self._port = port
        self._arrived = threading.Condition()
        self._received = bytearray()
        self._failure: Exception | None = None
        self._stopping = False
        port.timeout = _READ_S
        self._thread = threading.Thread(target=self._run, name="serial reader", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            while not self._stopping:
                # The driver waits for the first byte; in_waiting gives the number that came with it.
                data = self._port.read(1)
                if data:
                    data += self._port.read(self._port.in_waiting)
                    with self._arrived:
                        self._received += data
                        self._arrived.notify()
                        if len(self._received) > _LONGEST:
                            raise OSError(f"{len(self._received)} bytes were not read")
        except Exception as error:  # noqa: BLE001 - read() raises it in the caller's thread
            with self._arrived:
                self._failure = error
                self._arrived.notify()

    def read(self, timeout_ns: int) -> bytes:
        """Return what has arrived, waiting at most ``timeout_ns``. Raises OSError when the port is lost."""
        with self._arrived:
            if not self._received and self._failure is None and timeout_ns > 0:
                self._arrived.wait(timeout_ns * 1e-9)
            data = bytes(self._received)
            self._received.clear()
        if not data and self._failure is not None:
            raise OSError(str(self._failure)) from self._failure
        return data

    def stop(self) -> None:
        """Ask the thread to end."""
        self._stopping = True

    def join(self) -> None:
        """Wait for the thread; call it after the port was closed."""
        self._thread.join()


def _open_failure(port: str, baud: int, error: Exception) -> LinkError:
    text = str(error)
    scheme, is_url, _ = port.partition("://")
    if "baudrate" in text or "baud rate" in text:
        return LinkError(
            f"serial port {port!r} refuses {baud} baud; common rates are 115200, 921600, 1000000 and 2000000: set "
            "baud= in the link, and the same rate in the robot"
        )
    if is_url and scheme in ("socket", "rfc2217"):
        reason = "its port number is missing" if "NoneType" in text else words_of(error)
        return LinkError(
            f"serial URL {port!r} could not be opened ({reason}); expected {scheme}://HOST:PORT, with the "
            "serial server running there and no other client connected to it"
        )
    if (problem := opening_problem(error)) is not None:
        return LinkError(f"serial port {port!r} {problem}")
    return LinkError(f"serial port {port!r} could not be opened: {words_of(error)}; {LIST_PORTS}")


class SerialStream:
    """A serial port as a byte stream, opened exclusively.

    Reads wait in ``select`` if the port has a file descriptor, otherwise in a ``Reader``. A terminal device is read and
    written by ``Terminal``, and by pyserial where that is not enough. The driver's low-latency mode is set if it has
    one. A write that is not accepted within 1 s means that the line is lost.

    Raises LinkError when the port does not exist, is busy, is forbidden, is no serial port or refuses the baud rate.
    """

    lost_frames = 0  # unknown: a port does not report bytes that nobody reads

    def __init__(self, port: str, baud: int) -> None:
        self._name = port
        self._baud = baud
        self._port: Any = None
        self._reader: Reader | None = None
        self._terminal: Terminal | None = None
        self._low_latency = False
        self._opening: OpeningBeside[Any] | None = None
        self._use(self._opened())

    def reopen(self) -> None:
        """Close the port and open it again. Raises LinkError as the class does.

        Connecting to a server may take seconds, and continues in its own thread. Until it is done each call raises a
        LinkError that says so; a later call takes the result.
        """
        self._release()
        if not self._name.startswith(_SERVERS):
            self._use(self._opened())
            return
        opening, self._opening = self._opening or OpeningBeside(self._opened), None
        port = opening.result(_CONNECTING_S)
        if port is None:
            self._opening = opening
            raise LinkError(f"serial URL {self._name!r} is being connected to; its server has not answered yet")
        self._use(port)

    def _opened(self) -> Any:
        port: Any = None
        try:
            port = serial.serial_for_url(self._name, baudrate=self._baud, timeout=0, do_not_open=True)
            if not self._name.startswith("rfc2217:"):  # its writes have their own limit of 5 s
                port.write_timeout = _WRITE_TIMEOUT_S
            if "://" not in self._name:
                port.exclusive = True
            port.open()
        except _OPENING_FAILURES as error:
            _close(port)
            raise _open_failure(self._name, self._baud, error) from error
        return port

    def _use(self, port: Any) -> None:
        self._port = port
        has_descriptor = self._has_descriptor()
        try:
            # Bytes sent before the port was opened are not for this run.
            port.reset_input_buffer()
            self._reader = None if has_descriptor else Reader(port)
        except _OPENING_FAILURES as error:
            self._release()
            raise _open_failure(self._name, self._baud, error) from error
        self._terminal = Terminal(self._port.fileno()) if has_descriptor and "://" not in self._name else None
        self._low_latency = self._set_low_latency()

    def _has_descriptor(self) -> bool:
        try:
            select.select([self._port.fileno()], [], [], 0)
        except (AttributeError, OSError, ValueError):
            return False  # Windows, and URLs without a file descriptor
        return True

    def _set_low_latency(self) -> bool:
        """Linux: deliver bytes at once (ASYNC_LOW_LATENCY); USB adapters otherwise collect them for up to 16 ms."""
        try:
            self._port.set_low_latency_mode(True)
        except (AttributeError, NotImplementedError, ValueError):
            return False  # raised by pyserial if the platform or the driver has no such mode
        return True

    def write(self, data: bytes) -> None:
        if self._terminal is not None:
            written = self._terminal.write(data)
            if written == len(data):
                return
            data = data[written:]
        try:
            self._port.write(data)
        except serial.SerialTimeoutException as error:
            raise LinkError(
                f"serial port {self._name!r} took no byte for {_WRITE_TIMEOUT_S:g} s; check that the robot reads, and "
                "the line's flow control"
            ) from error
        except _LOSSES as error:
            raise self._lost(error) from error

    def read(self, timeout_ns: int) -> bytes:
        try:
            if timeout_ns < 0 and self._terminal is not None and (data := self._terminal.read()) is not None:
                return data
            if self._reader is not None:
                return self._reader.read(timeout_ns)
            if timeout_ns > 0:
                select.select([self._port.fileno()], [], [], timeout_ns * 1e-9)
            return bytes(self._port.read(_CHUNK))
        except _LOSSES as error:
            raise self._lost(error) from error

    def _lost(self, error: Exception) -> LinkError:
        why = GONE if is_gone(error) else words_of(error)
        return LinkError(f"serial port {self._name!r} was lost ({why}); check the cable and the robot's power")

    def describe(self) -> str:
        latency = "set" if self._low_latency else "not offered by its driver"
        return f"serial port {self._name} at {self._baud} baud, low latency {latency}"

    def close(self) -> None:
        if self._opening is not None:
            self._opening.abandon()
            self._opening = None
        self._release()

    def _release(self) -> None:
        self._terminal = None
        if self._reader is not None:
            self._reader.stop()
        _close(self._port)
        if self._reader is not None:
            self._reader.join()
            self._reader = None


def _close(port: Any) -> None:
    if port is not None:
        # Even closing may fail for an unplugged device; its descriptor is released all the same.
        with contextlib.suppress(*_LOSSES):
            port.close()
