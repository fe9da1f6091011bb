"""The routes of the API: one for each order, and routes for the status, the metrics and the WebSocket."""

from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping, Sequence
from inspect import Parameter, Signature
from typing import Any

from fastapi import FastAPI, Request, Response, Security, WebSocket
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from fastapi.security import HTTPBearer
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    InfoMetricFamily,
    Metric,
    StateSetMetricFamily,
)
from prometheus_client.registry import Collector
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException

from hil.addons.service.api.access import Access
from hil.addons.service.api.bodies import Body, bodies, sentence
from hil.addons.service.api.control import Control, NotDoneError
from hil.addons.service.api.live import LiveClient
from hil.addons.service.messages import ORDERS, Action, ApiConfig, Phase, Status, Task, route
from hil.core.printable import printable


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
    504: {"model": Refusal, "description": "The control process does not answer in time"},
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
    metrics = _ServiceMetrics(control, dropped)

    @app.get("/v1/status", response_model=Status, responses=_some(401, 504), summary="The status", tags=["status"])
    async def status() -> Response:
        return JSONResponse(control.fresh_status())

    @app.get("/metrics", summary="For Prometheus", response_class=Response, responses=_some(401), tags=["status"])
    async def prometheus() -> Response:
        return Response(metrics.text(), headers={"content-type": CONTENT_TYPE_LATEST})

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


class _ServiceMetrics(Collector):
    """Prometheus metrics of a service, made from its newest status at each request.

    Units are base units, counters end in ``_total``, and each quantity has one family.

    ``dropped`` are the numbers of connections that were dropped, by cause.
    """

    def __init__(self, control: Control, dropped: Mapping[str, int]) -> None:
        self._control = control
        self._dropped = dropped
        self._registry = CollectorRegistry()
        self._registry.register(self)

    def text(self) -> bytes:
        """Return the metrics in Prometheus' text format."""
        return generate_latest(self._registry)

    def collect(self) -> Iterator[Metric]:
        """Yield the families."""
        control = self._control
        documentation = "Age of the control process's last status; it sends 20 a second."
        yield GaugeMetricFamily("hil_status_age_seconds", documentation, control.status_age_s)
        yield GaugeMetricFamily("hil_api_live_clients", "Clients on the WebSocket.", len(control.watchers))
        orders = [((action.value, outcome), number) for (action, outcome), number in sorted(control.outcomes.items())]
        yield _labelled("hil_api_orders", "Orders to the control process.", ("action", "outcome"), orders)
        causes = ("late", "crowded", "flood", "unknown", "not_accepted")
        dropped = [((cause,), self._dropped.get(cause, 0)) for cause in causes]
        yield _labelled("hil_api_connections_dropped", "Connections that were dropped, by cause.", ("cause",), dropped)
        documentation = "Lines that the audit log could not take."
        yield CounterMetricFamily("hil_api_audit_failures", documentation, control.audit.failures)
        if control.status is not None:
            yield from _of_status(control.status)


def _labelled(
    name: str, documentation: str, labels: Sequence[str], numbers: Iterable[tuple[Sequence[str], int]]
) -> CounterMetricFamily:
    counter = CounterMetricFamily(name, documentation, labels=labels)
    for values, number in numbers:
        counter.add_metric(values, number)
    return counter


def _of_status(status: Mapping[str, Any]) -> Iterator[Metric]:
    """Yield the families of a status; an unknown value is left out, as is usual for Prometheus."""
    served = {name: status[name] for name in ("scenario", "law", "command", "link")}
    yield InfoMetricFamily("hil_service", "What is served.", served)
    for name, documentation, kind in (
        ("phase", "State of the robot.", Phase),
        ("task", "Task of an active robot.", Task),
    ):
        yield StateSetMetricFamily(f"hil_{name}", documentation, {one.value: one == status[name] for one in kind})
    frames = status["frames"]
    for name, documentation, number in (
        ("hil_ticks", "Ticks of the control loop.", status["ticks"]),
        ("hil_deadline_misses", "Ticks that began after their deadline.", status["deadline_misses"]),
        ("hil_recoveries", "Losses of the robot that were recovered from.", status["recoveries"]),
        ("hil_rows_dropped", "Rows that the recorder had no room for.", status["rows_dropped"]),
        ("hil_rows_lost", "Rows that the recorder could not write.", status["rows_lost"]),
        ("hil_frames_sent", "Frames to the robot.", frames["sent"]),
        ("hil_frames_received", "Frames from the robot.", frames["received"]),
    ):
        yield CounterMetricFamily(name, documentation, number)
    documentation = "Frames from the robot that were not valid, by cause."
    rejected = [((cause,), number) for cause, number in sorted(frames["rejected"].items())]
    yield _labelled("hil_frames_rejected", documentation, ("cause",), rejected)
    for name, documentation, value, unit in (
        ("feedback_age_seconds", "Age of the feedback that the last tick used.", status["feedback_age_ms"], 1e-3),
        ("round_trip_seconds", "From a command to the feedback that shows it.", status["round_trip_ms"], 1e-3),
        ("battery_volts", "Battery of the robot.", status["battery_v"], 1.0),
        ("twist_age_seconds", "Age of the twist in force.", status["twist_age_s"], 1.0),
        ("power_stage", "1 when the robot has motors.", status["power_stage"], 1.0),
        ("recording", "1 while a recording is written.", status["recording"] is not None, 1.0),
        ("recording_trouble", "1 when a recording cannot be written.", status["recording_trouble"] is not None, 1.0),
    ):
        if value is not None:
            yield GaugeMetricFamily(f"hil_{name}", documentation, value * unit)
    # The library has no family for quantiles that were computed elsewhere.
    lateness = Metric("hil_lateness_seconds", "Start of a tick after its deadline, since the service began.", "summary")
    for name, value_us in status["lateness_us"].items():
        if value_us is not None:
            quantile = {"quantile": f"{float(name[1:]) / 100.0:g}"}
            lateness.add_sample("hil_lateness_seconds", quantile, value_us / 1e6)
    lateness.add_sample("hil_lateness_seconds_count", {}, status["ticks"])
    yield lateness
