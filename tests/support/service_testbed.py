"""A real API process, against a control side with answers from the test: no robot, but real pipes and messages."""

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import httpx
import pytest
from websockets.sync.client import ClientConnection, connect

from hil.addons.service.api_child import ApiChild
from hil.addons.service.messages import SILENT_S, Action, Answer, ApiConfig, Limits, Order, Phase, Status, Task
from tests.support.processes import wait_for

# With a timeout as short as a robot's, an API process that waits for a processor refuses twists, as it should.
LIMITS = Limits(speed_m_s=2.0, yaw_rate_rad_s=4.0, distance_m=100.0, wheel=40.0, twist_timeout_s=SILENT_S)
STATUS = Status(
    time_unix_s=1.7e9,
    phase=Phase.ACTIVE,
    task=Task.HOLD,
    why=None,
    scenario="paper_circle",
    law="pid",
    command="speed",
    link="serial:/dev/ttyACM0",
    robot="firmware 1.2",
    power_stage=False,
    pose=(1.0, -0.5, 0.5),
    twist=(0.1, 0.0, -0.2),
    reference=None,
    speed_rad_s=(1.0, 2.0, 3.0, 4.0),
    battery_v=24.5,
    gains={"kp": 3.0},
    health=None,
    ticks=1234,
    deadline_misses=2,
    lateness_us={"p50": 51.0, "p99": 90.0, "p99.9": float("nan")},
    feedback_age_ms=1.5,
    round_trip_ms=None,
    frames={"sent": 10, "received": 9, "rejected": {"crc": 1}},
    recoveries=1,
    recording=None,
    rows_dropped=0,
    twist_age_s=None,
    realtime={"memory": "memory: locked"},
)


class ControlSide:
    """The control process's loop in a thread: takes orders each millisecond, sends the status each 50 ms.

    Attributes:
        orders: those received, in order. answer: its answer to an order, None for nothing. speaks: whether it sends the
        status. status: the status to send. turn: whoever holds it stops the loop.
    """

    def __init__(self, child: ApiChild) -> None:
        self.child = child
        self.orders: list[Order] = []
        self.answer: Callable[[Order], Answer | None] = lambda order: Answer(order.number)
        self.speaks = True
        self.status = STATUS
        self.turn = threading.Lock()
        self._late: deque[Answer] = deque()
        # With verify, each client would load all certificates, for 0.1 s.
        self._http = httpx.Client(trust_env=False, verify=False, timeout=30.0)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    @property
    def actions(self) -> list[Action]:
        return [order.action for order in self.orders]

    @property
    def headers(self) -> dict[str, str]:
        assert self.child.token_file is not None
        return {"Authorization": f"Bearer {self.child.token_file.read_text().strip()}"}

    def request(self, method: str, path: str, **options: Any) -> httpx.Response:
        options.setdefault("headers", self.headers)
        return self._http.request(method, self.child.url + path, **options)

    def in_time(self, method: str, path: str, **options: Any) -> httpx.Response:
        """Request again while the API had no processor in time: then it refuses, or reports no answer."""
        return wait_for(lambda: (got := self.request(method, path, **options)).status_code not in (503, 504) and got)

    def live(self, headers: dict[str, str] | None = None) -> ClientConnection:
        address = self.child.url.replace("http", "ws", 1) + "/v1/live"
        return connect(address, additional_headers=headers or self.headers, proxy=None, open_timeout=30.0)

    def forget(self) -> None:
        """Be as in the beginning."""
        self.answer_all()
        self.orders.clear()
        self.answer = lambda order: Answer(order.number)
        self.speaks = True
        self.status = STATUS

    def wait_until_it_answers(self) -> None:
        wait_for(lambda: self.request("GET", "/v1/status").status_code == 200)

    def answer_all(self) -> None:
        """Answer all that has come, however late."""
        self._late.extend(Answer(order.number) for order in self.orders)

    def refuse(self, sentence: str) -> None:
        self.answer = lambda order: Answer(order.number, sentence)

    def close(self) -> None:
        self._ends.set()
        self._thread.join()
        self._http.close()
        self.child.close()

    def _run(self) -> None:
        due_s = 0.0
        while not self._ends.wait(0.001):
            with self.turn:
                for order in self.child.orders():
                    self.orders.append(order)
                    if (answer := self.answer(order)) is not None:
                        self.child.send(answer)
                while self._late:
                    self.child.send(self._late.popleft())
                if self.speaks and time.monotonic() >= due_s:
                    due_s = time.monotonic() + 0.05
                    self.child.send(replace(self.status, time_unix_s=time.time()))


@contextlib.contextmanager
def served(**options: Any) -> Iterator[ControlSide]:
    """A service at a free port, that has sent its first status."""
    config = ApiConfig(**{"title": "paper_circle", "device": "a test", "limits": LIMITS, "port": 0} | options)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hil.addons.service.api_child._READY_S", 600.0)  # on a busy machine a start takes a minute
        side = ControlSide(ApiChild(config))
        try:
            side.wait_until_it_answers()
            yield side
        finally:
            side.close()
