"""A serial port served over TCP on loopback, as terminal servers do: RFC 2217 by pyserial's PortManager, or raw."""

import select
import socket
import threading

import serial
import serial.rfc2217


class ThreeWirePort(serial.Serial):
    """A port without modem lines, which a pseudo-terminal has not."""

    cts = dsr = ri = cd = False

    def _update_rts_state(self) -> None:
        """There is no such line."""

    _update_dtr_state = _update_rts_state


class SerialServer:
    """Serves one client after the other. ``port`` is a pyserial port, opened; ``rfc2217`` says what is spoken."""

    def __init__(self, port: serial.SerialBase, *, rfc2217: bool, listen: int = 0) -> None:
        self._port = port
        self._rfc2217 = rfc2217
        self._listener = socket.create_server(("127.0.0.1", listen))
        self.number = self._listener.getsockname()[1]
        self._wake, self._woken = socket.socketpair()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        return f"{'rfc2217' if self._rfc2217 else 'socket'}://127.0.0.1:{self.number}"

    def _run(self) -> None:
        while self._woken not in (ready := select.select([self._listener, self._woken], [], [])[0]):
            assert ready
            connection, _ = self._listener.accept()
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with connection:
                if not self._serve(connection):
                    return

    def _serve(self, connection: socket.socket) -> bool:
        """Return whether the client left, rather than the server was closed."""
        lock = threading.Lock()

        class Sending:
            def write(self, data: bytes) -> None:
                with lock:
                    connection.sendall(data)

        manager = serial.rfc2217.PortManager(self._port, Sending()) if self._rfc2217 else None
        while True:
            ready, _, _ = select.select([connection, self._port.fileno(), self._woken], [], [])
            if self._woken in ready:
                return False
            if connection in ready:
                try:
                    data = connection.recv(4096)
                except ConnectionError:
                    data = b""
                if not data:
                    return True
                self._port.write(b"".join(manager.filter(data)) if manager else data)
            if self._port.fileno() in ready:
                data = self._port.read(4096)
                with lock:
                    connection.sendall(b"".join(manager.escape(data)) if manager else data)

    def close(self) -> None:
        self._wake.close()
        self._thread.join()
        self._listener.close()
        self._woken.close()
