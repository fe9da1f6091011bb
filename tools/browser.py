"""A real Chromium without a window, driven over a pair of pipes by the DevTools protocol; POSIX only.

On Debian: ``apt-get install -y chromium``. It draws WebGL in software, so it needs no graphics card.
"""

import base64
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

_NAMES = ("chromium", "chromium-browser", "google-chrome")
_LOOK_S = 2.0  # a picture costs the browser time that it needs for the page
_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    "--remote-debugging-pipe",
)


class BrowserError(Exception):
    """The browser ended, refused a command, or did not show what was waited for."""


def chromium() -> str | None:
    """Return the path of a Chromium on this machine, or None."""
    return next(filter(None, map(shutil.which, _NAMES)), None)


class Page:
    """A page of the browser.

    ``errors`` are the errors that it and its frames wrote to the console: uncaught exceptions, the browser's own
    reports (each with its address), and ``console.error``.
    """

    def __init__(self, process: "subprocess.Popen[bytes]", commands: int, answers: int) -> None:
        self._process = process
        self._commands = commands
        self._answers = answers
        self._buffer = b""
        self._number = 0
        self._session: str | None = None
        self.errors: list[str] = []

    def open(self, address: str) -> None:
        """Open an address and wait until its page is loaded; what its scripts and frames load may come later."""
        if self._session is None:
            target = self._call("Target.createTarget", url="about:blank")["targetId"]
            self._session = self._call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
            for domain in ("Page", "Runtime", "Log"):
                self._call(f"{domain}.enable")
        self._call("Page.navigate", url=address)
        while self._note(self._read()) != "Page.loadEventFired":
            pass

    def picture(self) -> bytes:
        """Return what the page shows, as PNG."""
        return base64.b64decode(self._call("Page.captureScreenshot", format="png")["data"])

    def resize(self, width: int, height: int, *, is_phone: bool = False) -> None:
        """Make the page this large in CSS pixels; of a phone, which is touched, with a pixel density of 2."""
        density = 2 if is_phone else 1
        self._call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=density, mobile=is_phone
        )
        self._call("Emulation.setTouchEmulationEnabled", enabled=is_phone)

    def value(self, expression: str) -> Any:
        """Return what a JavaScript expression gives, as JSON has it; a promise is waited for."""
        found = self._call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise BrowserError(f"{expression}: {found['exceptionDetails']['text']}")
        return found["result"].get("value")

    def wait_until(self, expression: str, timeout_s: float) -> None:
        """Wait until a JavaScript expression is true. Raises BrowserError after ``timeout_s``."""
        watch = (
            f"new Promise((done) => {{ const end = Date.now() + {timeout_s * 1e3}; const look = () => "
            f"({expression}) ? done(true) : Date.now() > end ? done(false) : setTimeout(look, 20); look(); }})"
        )
        if not self.value(watch):
            raise BrowserError(f"{expression} is not true after {timeout_s:g} s; the page's errors: {self.errors}")

    def mouse(self, kind: str, x: float, y: float) -> None:
        """Move or press the mouse at a place of the page that is shown; ``kind``: mouseMoved, -Pressed, -Released."""
        pressed = {} if kind == "mouseMoved" else {"button": "left", "clickCount": 1}
        self._call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **pressed)

    def printed(self) -> bytes:
        """Return the page as it is printed, as PDF, in the size that its style asks for."""
        answer = self._call("Page.printToPDF", preferCSSPageSize=True, printBackground=True)
        return base64.b64decode(answer["data"])

    def wait_for(self, is_shown: Callable[[bytes], bool], timeout_s: float) -> bytes:
        """Return the first picture of which ``is_shown`` holds. Raises BrowserError after ``timeout_s``."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            if is_shown(picture := self.picture()):
                return picture
            time.sleep(_LOOK_S)
        raise BrowserError(f"the page does not show it after {timeout_s:g} s; its errors: {self.errors}")

    def _call(self, method: str, **parameters: object) -> dict[str, Any]:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._commands, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise BrowserError(f"{method}: {answer['error']['message']}")
                result: dict[str, Any] = answer["result"]
                return result
            self._note(answer)

    def _note(self, event: dict[str, Any]) -> str | None:
        """Keep what an event says of an error; return the event's name."""
        parameters = event.get("params", {})
        if event.get("method") == "Runtime.exceptionThrown":
            details = parameters["exceptionDetails"]
            self.errors.append(f"{details['text']} {details.get('exception', {}).get('description', '')}".strip())
        elif event.get("method") == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            entry = parameters["entry"]
            self.errors.append(f"{entry['text']} {entry.get('url', '')}".strip())
        elif event.get("method") == "Runtime.consoleAPICalled" and parameters["type"] == "error":
            said = [one.get("value", one.get("description", one["type"])) for one in parameters["args"]]
            self.errors.append(" ".join(map(str, said)))
        return event.get("method")

    def _read(self) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            data = os.read(self._answers, 1 << 16)
            if not data:
                raise BrowserError(f"the browser ended with exit status {self._process.wait()}")
            self._buffer += data
        message, _, self._buffer = self._buffer.partition(b"\0")
        answer: dict[str, Any] = json.loads(message)
        return answer


@contextmanager
def browser(width: int = 1280, height: int = 800) -> Iterator[Page]:
    """Start a Chromium with a profile of its own and give a page of it. Raises BrowserError when there is none."""
    executable = chromium()
    if executable is None:
        raise BrowserError("no chromium was found: apt-get install -y chromium")
    from_us, commands = os.pipe()
    answers, to_us = os.pipe()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        # Chromium reads commands from descriptor 3 and answers on 4.
        script = f'exec "$@" 3<&{from_us} 4>&{to_us}'
        command = [executable, *_FLAGS, f"--window-size={width},{height}", f"--user-data-dir={profile}"]
        process = subprocess.Popen(
            ["bash", "-c", script, "bash", *command],
            pass_fds=(from_us, to_us),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(from_us)
        os.close(to_us)
        try:
            yield Page(process, commands, answers)
        finally:
            os.close(commands)  # the browser ends with its commands
            os.close(answers)
            try:
                process.wait(timeout=10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
