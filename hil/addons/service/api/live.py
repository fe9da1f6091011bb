"""The WebSocket of the API: sends statuses as they come; takes orders and sends their answers.

Messages are JSON objects, as on the pipe between the processes:

    to the client    {"status": {...}}    {"answer": {"number": 7, "refused": null, "result": {}}}
    from the client  {"order": {"number": 7, "action": "twist", "arguments": {"vx_m_s": 0.2, ...}}}

A client that sends {"motion": {"rate_hz": 200}} also gets {"motion": {...}} that often, as far as the ticks allow it.

The client chooses the number. One that reads slowly gets all answers, but of the statuses and motions only the newest.
"""

import asyncio
import contextlib
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Self

from pydantic import BaseModel, Field, ValidationError, model_validator
from starlette.websockets import WebSocket, WebSocketDisconnect
from websockets.frames import CloseCode

from hil.addons.service import logs
from hil.addons.service.api.access import TOO_MANY, Access, Client
from hil.addons.service.api.bodies import Body, sentence
from hil.addons.service.api.control import Control, NotDoneError
from hil.addons.service.messages import Action, Answer, to_line

_LONGEST_BACKLOG = 256
_NO_NUMBER = -1  # of the answer to a message that is no order


class _Order(BaseModel, extra="forbid", strict=True):
    number: int = Field(ge=0, le=2**53)
    action: Action
    arguments: dict[str, Any] = {}


class _MotionWish(BaseModel, extra="forbid", strict=True):
    rate_hz: float = Field(ge=0.0, le=1000.0)


class _Message(BaseModel, extra="forbid", strict=True):
    order: _Order | None = None
    motion: _MotionWish | None = None

    @model_validator(mode="after")
    def _is_one(self) -> Self:
        if (self.order is None) is (self.motion is None):
            raise ValueError("expected order or motion")
        return self


class LiveClient:
    """One client on the WebSocket, from its handshake to its end."""

    def __init__(
        self, socket: WebSocket, control: Control, access: Access, bodies: Mapping[Action, type[Body]]
    ) -> None:
        self._socket = socket
        self._control = control
        self._access = access
        self._client: Client = socket.state.client  # renewed by ``_is_known``
        self._bodies = bodies
        self._answers: deque[Answer] = deque()
        self._news = asyncio.Event()
        self._pending: set[asyncio.Task[None]] = set()
        self._closed_why: str | None = None
        self._wants_motion = False

    async def serve(self) -> None:
        """Serve the client until it or the control process ends."""
        await self._socket.accept()
        self._control.watchers.add(self._news)
        self._news.set()
        tasks = [asyncio.create_task(one) for one in (self._listen(), self._send(), self._control.gone.wait())]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._control.watchers.discard(self._news)
            if self._wants_motion:
                self._control.ask_for_motion(self._news, 0.0)
            for task in tasks:  # not those of ``_pending``: an order that was received must be sent
                task.cancel()
            ends = await asyncio.gather(*tasks, return_exceptions=True)
        if self._control.gone.is_set():
            await self._close(CloseCode.GOING_AWAY, "the control process has ended")
        elif self._closed_why is not None:
            await self._close(CloseCode.POLICY_VIOLATION, self._closed_why)
        for end in ends:
            if isinstance(end, Exception) and not isinstance(end, WebSocketDisconnect):
                raise end

    async def _listen(self) -> None:
        """Carry out orders as they come, until the client disconnects."""
        while True:
            message = await self._socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            if not self._is_known():
                return
            self._handle(message.get("text") or "")
            if len(self._answers) + len(self._pending) > _LONGEST_BACKLOG:
                logs.warning("live client is closed: it does not read its answers", unread=len(self._answers))
                self._closed_why = f"{_LONGEST_BACKLOG} answers are unread"
                return

    def _is_known(self) -> bool:
        """Return whether the client's token is still valid; take the roles that it has now."""
        if (client := self._access.client(self._socket.scope["headers"])) is None:
            self._closed_why = "its token is not valid any more"
            return False
        self._client = client._replace(address=self._client.address)
        return True

    def _handle(self, text: str) -> None:
        try:
            message = _Message.model_validate_json(text)
        except ValidationError as error:
            self._put(Answer(_NO_NUMBER, f"this is not an order: {sentence(error.errors())}"))
            return
        if message.motion is not None:
            self._control.ask_for_motion(self._news, message.motion.rate_hz)
            self._wants_motion = message.motion.rate_hz > 0.0
        if (order := message.order) is None:
            return
        if not self._access.is_in_time(self._client, order.action):
            self._control.not_sent(self._client, order.action, "too_many", TOO_MANY)
            self._put(Answer(order.number, TOO_MANY))
            return
        task = asyncio.create_task(self._carry_out(order))
        self._pending.add(task)

    async def _carry_out(self, order: _Order) -> None:
        try:
            body = self._bodies[order.action].model_validate(order.arguments)
            answer = await self._control.order(order.action, body.model_dump(), self._client)
        except ValidationError as error:
            why = sentence(error.errors())
            self._control.not_sent(self._client, order.action, "invalid", why)
            self._put(Answer(order.number, why))
        except NotDoneError as error:
            self._put(Answer(order.number, str(error)))
        else:
            self._put(replace(answer, number=order.number))
        finally:  # not when the task is done, which is later: an answer must not count twice
            self._pending -= {asyncio.current_task()}

    def _put(self, answer: Answer) -> None:
        self._answers.append(answer)
        self._news.set()

    async def _send(self) -> None:
        """Send every answer, and the newest status and motion, for as long as the token is valid."""
        sent: Mapping[str, Any] | None = None
        sent_motion: Mapping[str, Any] | None = None
        while True:
            await self._news.wait()
            self._news.clear()
            if not self._is_known():
                return
            while self._answers:
                await self._socket.send_json(to_line(self._answers.popleft()))
            if self._control.status is not sent and (sent := self._control.status) is not None:
                await self._socket.send_json({"status": sent})
            if self._wants_motion and (motion := self._control.motion) is not sent_motion and motion is not None:
                sent_motion = motion
                await self._socket.send_json({"motion": motion})

    async def _close(self, code: int, reason: str) -> None:
        with contextlib.suppress(RuntimeError, WebSocketDisconnect):  # the client has closed it already
            await self._socket.close(code, reason)
