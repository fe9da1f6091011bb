"""How long an emergency stop takes under floods: ``python -m tools.bench.estop [--number N] [--busy N]``.

A real ``hil serve`` with a virtual robot, and processes that flood it: whoever has no token, or one that may only read.
Meanwhile the owner gives emergency stops, each over a connection of its own, by the port of the e-stop and by that of
the API. Printed are median, 95th percentile and maximum [ms], and how often the API was started again. ``--busy`` adds
processes that only compute.
"""

import argparse
import asyncio
import base64
import contextlib
import json
import os
import secrets
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from http.client import HTTPConnection
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).parents[2]
_TIMEOUT_S = 20.0
_PERIOD_S = 0.05
_READ_TOKEN = "reads-" + secrets.token_hex(16)
_DRIVE_TOKEN = "drives-" + secrets.token_hex(16)
_TWIST = json.dumps({"vx_m_s": 0.1, "vy_m_s": 0.0, "yaw_rate_rad_s": 0.0})


class Target(NamedTuple):
    """Where a flood goes: the API's port, the port of the e-stop, and tokens."""

    api: int
    estop: int
    reads: str
    drives: str


def _connected(port: int) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), _TIMEOUT_S)


def _request(port: int, method: str, path: str, token: str, more: str = "") -> bytes:
    return (
        f"{method} {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nAuthorization: Bearer {token}\r\n{more}\r\n"
    ).encode()


def _frame(code: int, payload: bytes) -> bytes:
    """Return a masked WebSocket frame; a mask of zeros leaves the payload as it is."""
    size = len(payload)
    length = bytes([0x80 | size]) if size < 126 else bytes([0x80 | 126]) + size.to_bytes(2, "big")
    return bytes([0x80 | code]) + length + bytes(4) + payload


def _live(target: Target, token: str) -> socket.socket:
    upgrade = (
        "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        f"Sec-WebSocket-Key: {base64.b64encode(os.urandom(16)).decode()}\r\n"
    )
    one = _connected(target.api)
    one.sendall(_request(target.api, "GET", "/v1/live", token, upgrade))
    one.recv(4096)
    return one


def _frames(target: Target, token: str, frame: bytes, number: int = 1) -> None:
    """Send frames on WebSockets as fast as they go, and read what comes; begin again where one is closed."""

    async def send(writer: asyncio.StreamWriter, reader: asyncio.StreamReader) -> None:
        block = frame * max(1, 65536 // len(frame))
        reads = asyncio.create_task(reader.read(-1))
        with contextlib.suppress(OSError):
            while not reads.done():
                writer.write(block)
                await writer.drain()
        reads.cancel()
        writer.close()

    async def one() -> None:
        while True:
            with contextlib.suppress(OSError):
                reader, writer = await asyncio.open_connection(sock=await asyncio.to_thread(_live, target, token))
                await send(writer, reader)
            await asyncio.sleep(0.01)

    async def main() -> None:
        await asyncio.gather(*(one() for _ in range(number)))

    asyncio.run(main())


def _requests(port: int, text: bytes, number: int) -> None:
    """Send requests over kept connections, each as soon as the one before is answered."""

    async def one() -> None:
        while True:
            with contextlib.suppress(OSError, asyncio.IncompleteReadError, ValueError):
                reader, writer = await asyncio.open_connection("127.0.0.1", port)
                while True:
                    writer.write(text)
                    head = await reader.readuntil(b"\r\n\r\n")
                    await reader.readexactly(int(head.lower().partition(b"content-length: ")[2].split(b"\r\n")[0]))
            await asyncio.sleep(0.01)

    async def main() -> None:
        await asyncio.gather(*(one() for _ in range(number)))

    asyncio.run(main())


def _half_requests(port: int, number: int) -> None:
    """Keep connections open that sent half a header, each for as long as the server lets it."""
    half = b"POST /v1/estop HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Half: "
    opened: list[socket.socket] = []
    while True:
        with contextlib.suppress(OSError):
            opened.append(_connected(port))
            opened[-1].sendall(half)
        if len(opened) > number:
            opened.pop(0).close()


def _connects(port: int, text: bytes) -> None:
    """Open connections as fast as they go, send a text, and reset them."""
    while True:
        with contextlib.suppress(OSError):
            one = _connected(port)
            one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
            one.sendall(text)
            one.close()


def _garbage(port: int) -> None:
    while True:
        with contextlib.suppress(OSError), _connected(port) as one:
            for _ in range(64):
                one.sendall(os.urandom(65536))


FLOODS: dict[str, Callable[[Target], None]] = {
    "pings of one byte, one WebSocket": lambda to: _frames(to, to.reads, _frame(9, b"x")),
    "pings of one byte, 64 WebSockets": lambda to: _frames(to, to.reads, _frame(9, b"x"), 64),
    "pongs, empty": lambda to: _frames(to, to.reads, _frame(10, b"")),
    "texts that are no orders": lambda to: _frames(to, to.reads, _frame(1, b"{}")),
    "texts of 64 KiB, nested": lambda to: _frames(to, to.reads, _frame(1, b'{"order":' + b"[" * 60000)),
    "e-stops on the WebSocket": lambda to: _frames(
        to, to.reads, _frame(1, b'{"order":{"number":1,"action":"estop","arguments":{}}}')
    ),
    "motion at 1000 Hz, 64 WebSockets": lambda to: _frames_once(to, b'{"motion":{"rate_hz":1000}}', 64),
    "twists, 64 connections": lambda to: _requests(
        to.api,
        _request(
            to.api,
            "POST",
            "/v1/twist",
            to.drives,
            f"Content-Type: application/json\r\nContent-Length: {len(_TWIST)}\r\n",
        )
        + _TWIST.encode(),
        64,
    ),
    "statuses, 64 connections": lambda to: _requests(to.api, _request(to.api, "GET", "/v1/status", to.reads), 64),
    "metrics, 64 connections": lambda to: _requests(to.api, _request(to.api, "GET", "/metrics", to.reads), 64),
    "openapi.json, 64 connections": lambda to: _requests(
        to.api, _request(to.api, "GET", "/openapi.json", to.reads), 64
    ),
    "no token, 64 connections": lambda to: _requests(to.api, _request(to.api, "GET", "/v1/status", "none"), 64),
    "half headers, 1100 connections": lambda to: _half_requests(to.api, 1100),
    "garbage": lambda to: _garbage(to.api),
    "e-stop's port: half headers, 1100": lambda to: _half_requests(to.estop, 1100),
    "e-stop's port: connect and reset": lambda to: _connects(to.estop, b""),
    "e-stop's port: requests without token": lambda to: _connects(
        to.estop, _request(to.estop, "POST", "/v1/estop", "none")
    ),
    "e-stop's port: garbage": lambda to: _garbage(to.estop),
    "e-stop's port: e-stops by a read token": lambda to: _requests(
        to.estop, _request(to.estop, "POST", "/v1/estop", to.reads), 32
    ),
}


def _frames_once(target: Target, text: bytes, number: int) -> None:
    """Send a text on each of many WebSockets once, and read what comes."""

    async def one() -> None:
        while True:
            with contextlib.suppress(OSError):
                reader, writer = await asyncio.open_connection(
                    sock=await asyncio.to_thread(_live, target, target.reads)
                )
                writer.write(_frame(1, text))
                while await reader.read(65536):
                    pass
            await asyncio.sleep(0.01)

    async def main() -> None:
        await asyncio.gather(*(one() for _ in range(number)))

    asyncio.run(main())


class Served(NamedTuple):
    """A running service, and the file with its log."""

    target: Target
    token: str
    log: Path

    def restarts(self) -> int:
        """How often its API was started again, or the robot was stopped for its silence."""
        text = self.log.read_text(encoding="utf-8")
        return text.count("process ended")


@contextlib.contextmanager
def _served(folder: Path) -> Iterator[Served]:
    clients = folder / "clients"
    clients.touch(0o600)
    clients.write_text(f"panel read {_READ_TOKEN}\nstick drive {_DRIVE_TOKEN}\n", encoding="ascii")
    words = ["serve", "circle_speed", "--set", "service.port=0", "--set", "loop.rate_hz=100", "--log", "json"]
    log = folder / "log"
    with log.open("wb") as stderr:
        process = subprocess.Popen(
            [sys.executable, "-m", "hil.cli.main", *words, "--clients", str(clients)],
            stderr=stderr,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            cwd=folder,
        )
        try:
            from hil.addons.service.discovery import running

            while not (found := [one for one in running() if one.pid == process.pid]):
                if process.poll() is not None:
                    raise SystemExit(log.read_text(encoding="utf-8"))
                time.sleep(0.05)
            estop = getattr(found[0], "estop_url", None) or found[0].url
            target = Target(found[0].port, int(estop.rpartition(":")[2]), _READ_TOKEN, _DRIVE_TOKEN)
            yield Served(target, Path(found[0].token_file).read_text(encoding="ascii").strip(), log)
        finally:
            process.terminate()
            process.wait()


@contextlib.contextmanager
def _flooded(kind: str | None, target: Target, processes: int) -> Iterator[None]:
    words = [sys.executable, "-m", "tools.bench.estop", "--flood", kind or "", "--target", json.dumps(target)]
    floods = [subprocess.Popen(words, cwd=ROOT, stdout=subprocess.DEVNULL) for _ in range(processes if kind else 0)]
    try:
        time.sleep(2.0 if kind else 0.0)  # until it floods
        yield
    finally:
        for one in floods:
            one.kill()
            one.wait()


def _estop_ms(port: int, token: str) -> float:
    """Give an e-stop over a connection of its own; return how long its answer took [ms], or infinity without one."""
    begin_s = time.monotonic()
    connection = HTTPConnection("127.0.0.1", port, timeout=_TIMEOUT_S)
    try:
        connection.request("POST", "/v1/estop", headers={"Authorization": f"Bearer {token}"})
        is_done = connection.getresponse().status == 200
    except OSError:
        is_done = False
    finally:
        connection.close()
    return 1e3 * (time.monotonic() - begin_s) if is_done else float("inf")


def measure(served: Served, kind: str | None, number: int, processes: int) -> dict[str, Any]:
    """Measure e-stops by both ways, in turns, while one flood runs."""
    found: dict[str, Any] = {}
    restarts = served.restarts()
    with _flooded(kind, served.target, processes):
        for way, port in (("e-stop's port", served.target.estop), ("API's port", served.target.api)):
            took_ms: list[float] = []
            until_s = time.monotonic() + _TIMEOUT_S
            while len(took_ms) < number and (time.monotonic() < until_s or not took_ms):
                took_ms.append(_estop_ms(port, served.token))
                time.sleep(_PERIOD_S)
            took_ms.sort()
            last = len(took_ms) - 1
            found[way] = {
                "median_ms": statistics.median(took_ms),
                "p95_ms": took_ms[round(0.95 * last)],
                "max_ms": took_ms[last],
                "number": len(took_ms),
            }
    return found | {"api_restarts": served.restarts() - restarts}


def main() -> None:
    """Measure each flood, print a table, write the figures."""
    parser = argparse.ArgumentParser(prog="tools.bench.estop", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--number", type=int, default=60, metavar="N", help="e-stops by each way, at most 20 s of them")
    parser.add_argument("--processes", type=int, default=1, metavar="N", help="processes that flood")
    parser.add_argument("--busy", type=int, default=0, metavar="N", help="processes that compute besides")
    parser.add_argument("--only", default="", metavar="WORDS", help="floods with these words in their names")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures")
    parser.add_argument("--flood", help=argparse.SUPPRESS)
    parser.add_argument("--target", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.flood:
        with contextlib.suppress(KeyboardInterrupt):
            print("floods", flush=True)
            FLOODS[options.flood](Target(*json.loads(options.target)))
        return
    table = Table("flood", "way", "median", "p95", "max [ms]", "e-stops", "API restarts", title="emergency stops")
    figures: dict[str, Any] = {}
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(options.busy)]
    try:
        with tempfile.TemporaryDirectory() as folder:
            os.environ["XDG_STATE_HOME"] = folder
            with _served(Path(folder)) as served:
                for kind in (None, *(one for one in FLOODS if options.only in one)):
                    figures[kind or "none"] = found = measure(served, kind, options.number, options.processes)
                    for way in ("e-stop's port", "API's port"):
                        one = found[way]
                        times = (f"{one[name]:.1f}" for name in ("median_ms", "p95_ms", "max_ms"))
                        table.add_row(kind or "none", way, *times, str(one["number"]), str(found["api_restarts"]))
                    print(f"{kind or 'none'}: {found}", file=sys.stderr)
    finally:
        for one in busy:
            one.kill()
            one.wait()
    Console(width=120).print(table)
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
