"""The routes of the API: one for each order, and routes for the status, the metrics and the WebSocket."""

from collections.abc import Awaitable, Callable, Mapping
from inspect import Parameter, Signature
from typing import Any

from fastapi import FastAPI, Request, Response, Security, WebSocket
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from fastapi.security import HTTPBearer
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException

from hil.core.printable import printable
from hil.service.api.access import Access
from hil.service.api.bodies import Body, bodies, sentence
from hil.service.api.control import Control, NotDoneError
from hil.service.api.live import LiveClient
from hil.service.api.metrics import ServiceMetrics
from hil.service.messages import ORDERS, Action, ApiConfig, Status, route


class Refusal(BaseModel):
    """Why a request was refused."""

    detail: str = Field(description="a sentence for the user")


class Done(BaseModel):
    """The order was accepted; its motion may go on for a long time."""

    result: dict[str, Any] = Field(description="further results, by name")


_REFUSALS: dict[int | str, dict[str, Any]] = {
    400: {"model": Refusal, "description": "The body cannot be read"},
    401: {"model": Refusal, "description": "The token is missing or wrong"},
    403: {"model": Refusal, "description": "The token lacks the role that the order needs"},
    409: {"model": Refusal, "description": "The control process refuses: the order is not possible now"},
    415: {"model": Refusal, "description": "The body was not sent as JSON"},
    422: {"model": Refusal, "description": "The body is not valid"},
    429: {"model": Refusal, "description": "Too many orders a second were given with this token"},
    503: {"model": Refusal, "description": "The control process has too many orders to answer, or is ending"},
    504: {"model": Refusal, "description": "The control process does not answer within a second"},
}


_UNREAD = "the body cannot be read: it is nested too deeply, has a number that is too long, is no text, or ended early"
_LONGEST_ECHO = 80


def make_app(config: ApiConfig, control: Control, access: Access, dropped: Mapping[str, int]) -> FastAPI:
    """Return the application. ``server.Gate`` is in front of it: it puts the client into the state of each request.

    ``dropped`` are the numbers of connections that were dropped, by cause.
    """
    app = FastAPI(
        title=printable(f"hil serve: {config.title}"),
        version="1",
        description=printable(f"Drives the robot behind {config.device}."),
        # FastAPI's page would be blank: it loads its scripts from another machine.
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
        # Only for the OpenAPI document: Gate checks the token.
        dependencies=[Security(HTTPBearer(auto_error=False, description="the token of this start"))],
    )
    checked = bodies(config.limits)
    metrics = ServiceMetrics(control, dropped)

    @app.get("/v1/status", response_model=Status, responses=_some(401, 504), summary="The status", tags=["status"])
    async def status() -> Response:
        return JSONResponse(control.fresh_status())

    @app.get("/metrics", summary="For Prometheus", response_class=Response, responses=_some(401), tags=["status"])
    async def prometheus(request: Request) -> Response:
        text, content_type = metrics.text(request.headers.get("accept", ""))
        return Response(text, headers={"content-type": content_type})

    @app.websocket("/v1/live")
    async def live(socket: WebSocket) -> None:
        await LiveClient(socket, control, access, checked).serve()

    for action in Action:
        method, path = route(action)
        app.add_api_route(
            path,
            _endpoint(control, action, checked[action]),
            methods=[method],
            summary=action.summary.rstrip("."),
            operation_id=action.value,
            response_model=Done,
            responses=_REFUSALS,
            tags=["orders"],
        )

    def refused(request: Request, status: int, why: str, headers: Mapping[str, str] | None = None) -> Response:
        if (action := ORDERS.get((request.method, request.url.path))) is not None:
            control.not_sent(request.state.client, action, "invalid", why)
        return JSONResponse({"detail": why}, status, headers)

    @app.exception_handler(RequestValidationError)
    async def invalid(request: Request, error: RequestValidationError) -> Response:
        if not isinstance(error.body, bytes):
            return refused(request, 422, sentence(error.errors()))
        given = printable(repr(request.headers.get("content-type", ""))[:_LONGEST_ECHO])
        return refused(request, 415, f"Content-Type = {given}: send the body as JSON, with application/json")

    @app.exception_handler(HTTPException)
    async def not_read(request: Request, error: HTTPException) -> Response:
        return refused(request, error.status_code, _UNREAD if error.status_code == 400 else error.detail, error.headers)

    app.exception_handler(NotDoneError)(_not_done)
    return app


def _some(*statuses: int) -> dict[int | str, dict[str, Any]]:
    return {status: _REFUSALS[status] for status in statuses}


def _endpoint(control: Control, action: Action, model: type[Body]) -> Callable[..., Awaitable[Response]]:
    async def order(request: Request, body: Body | None = None) -> Response:
        answer = await control.order(action, (body or model()).model_dump(), request.state.client)
        if answer.refused is not None:
            return JSONResponse({"detail": answer.refused}, 409)
        return JSONResponse({"result": answer.result})

    parameters = [Parameter("request", Parameter.KEYWORD_ONLY, annotation=Request)]
    if model.model_fields:
        is_required = any(field.is_required() for field in model.model_fields.values())
        default, annotation = (Parameter.empty, model) if is_required else (None, model | None)
        parameters.append(Parameter("body", Parameter.KEYWORD_ONLY, default=default, annotation=annotation))
    # The models have this service's ranges, which an annotation in the source cannot name.
    order.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    return order


async def _not_done(_request: Request, error: Exception) -> Response:
    assert isinstance(error, NotDoneError)
    return JSONResponse({"detail": str(error)}, error.http_status)
