"""The routes of the API: every order is one, by this table; status, metrics and the WebSocket are the others."""

from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple

from fastapi import FastAPI, Request, Response, Security, WebSocket
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from fastapi.security import HTTPBearer
from pydantic import BaseModel, Field

from hil.service.api.bodies import Body, bodies, sentence
from hil.service.api.control import BusyError, Control, NoAnswerError
from hil.service.api.live import LiveClient
from hil.service.api.metrics import ServiceMetrics
from hil.service.api_config import ApiConfig
from hil.service.messages import Action, Status


class Refusal(BaseModel):
    """Why something was not done."""

    detail: str = Field(description="a sentence for the user")


class Done(BaseModel):
    """The order was accepted; a motion may go on for long after."""

    result: dict[str, Any] = Field(description="what there is more to say, by name")


class _Route(NamedTuple):
    method: str
    path: str
    action: Action
    summary: str
    may_be_empty: bool = False
    """Whether the body may be left out, which then has its defaults."""


_ORDERS = (
    _Route("POST", "/v1/arm", Action.ARM, "Arm: the robot may move from here on, and is held at rest"),
    _Route("POST", "/v1/disarm", Action.DISARM, "Ramp down, and disarm"),
    _Route("POST", "/v1/estop", Action.ESTOP, "Emergency stop; it comes before any other order"),
    _Route("POST", "/v1/clear", Action.CLEAR, "Leave FAULT or ESTOP when the cause is gone; arms nothing"),
    _Route("POST", "/v1/track", Action.TRACK, "Follow a path", may_be_empty=True),
    _Route("POST", "/v1/go", Action.GO, "Drive to a pose"),
    _Route("POST", "/v1/twist", Action.TWIST, "Drive by twist, until it times out"),
    _Route("POST", "/v1/stop", Action.STOP, "Ramp down to rest, and hold; the robot stays armed"),
    _Route("POST", "/v1/gains", Action.GAINS, "Change the law's gains, or read them again", may_be_empty=True),
    _Route("POST", "/v1/record", Action.RECORD, "Begin a recording", may_be_empty=True),
    _Route("DELETE", "/v1/record", Action.STOP_RECORDING, "End the recording"),
    _Route("POST", "/v1/shutdown", Action.SHUTDOWN, "Ramp down, disarm, close the recording and end"),
)

_REFUSALS: dict[int | str, dict[str, Any]] = {
    400: {"model": Refusal, "description": "The body cannot be read: nested too deeply, or a number too long"},
    401: {"model": Refusal, "description": "The token is missing or wrong"},
    409: {"model": Refusal, "description": "The control process refuses: it makes no sense now"},
    422: {"model": Refusal, "description": "The body is not as it should be"},
    503: {"model": Refusal, "description": "The control process has too much to answer, or is ending"},
    504: {"model": Refusal, "description": "The control process does not answer within a second"},
}


def make_app(config: ApiConfig, control: Control) -> FastAPI:
    """Return the application. Who may use it is ``access.Gate``'s business, which is to be put in front."""
    app = FastAPI(
        title=f"hil serve: {config.title}",
        version="1",
        description=f"Drives the robot behind {config.device}.",
        # Its page would be blank: it loads its scripts from another machine.
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
        # What Gate has checked, for the document.
        dependencies=[Security(HTTPBearer(auto_error=False, description="the token of this start"))],
    )
    checked = bodies(config.limits)
    metrics = ServiceMetrics(control)

    @app.get("/v1/status", response_model=Status, responses=_some(401, 504), summary="How it is", tags=["status"])
    async def status() -> Response:
        return JSONResponse(control.fresh_status())

    @app.get("/metrics", summary="For Prometheus", response_class=Response, responses=_some(401), tags=["status"])
    async def prometheus(request: Request) -> Response:
        text, content_type = metrics.text(request.headers.get("accept", ""))
        return Response(text, headers={"content-type": content_type})

    @app.websocket("/v1/live")
    async def live(socket: WebSocket) -> None:
        await LiveClient(socket, control, checked).serve()

    for route in _ORDERS:
        app.add_api_route(
            route.path,
            _endpoint(control, route, checked[route.action]),
            methods=[route.method],
            summary=route.summary,
            operation_id=route.action.value,
            response_model=Done,
            responses=_REFUSALS,
            tags=["orders"],
        )

    app.exception_handler(RequestValidationError)(_invalid)
    app.exception_handler(NoAnswerError)(_says(504))
    app.exception_handler(BusyError)(_says(503))
    return app


def _some(*statuses: int) -> dict[int | str, dict[str, Any]]:
    return {status: _REFUSALS[status] for status in statuses}


def _endpoint(control: Control, route: _Route, model: type[Body]) -> Callable[..., Awaitable[Response]]:
    async def order(arguments: dict[str, Any]) -> Response:
        answer = await control.answer(route.action, control.submit(route.action, arguments))
        if answer.refused is not None:
            return JSONResponse({"detail": answer.refused}, 409)
        return JSONResponse({"result": answer.result})

    if model is Body:

        async def without_body() -> Response:
            return await order({})

        return without_body

    async def with_body(body: Any) -> Response:
        return await order((model() if body is None else body).model_dump())

    # The models have ranges of this service, which an annotation in the source cannot name.
    with_body.__annotations__["body"] = model | None if route.may_be_empty else model
    if route.may_be_empty:
        with_body.__defaults__ = (None,)
    return with_body


async def _invalid(_request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    return JSONResponse({"detail": sentence(error.errors())}, 422)


def _says(status: int) -> Callable[[Request, Exception], Awaitable[Response]]:
    async def answer(_request: Request, error: Exception) -> Response:
        return JSONResponse({"detail": str(error)}, status)

    return answer
