"""How a running service is: its status and its metrics, read from its API."""

from collections.abc import Iterator, Mapping
from typing import Any

from hil.cli.checks import Finding, note, ok, ok_or_note, problem

_LATE_SHARE = 0.05
_REJECTED_SHARE = 0.01
_OLD_MS = 100.0


def check_service(status: Mapping[str, Any], metrics: Mapping[str, float]) -> Iterator[Finding]:
    """Yield how robot, loop, link and recording of a service are, and who troubles its API.

    ``status`` is as ``hil.service.messages.Status`` says. ``metrics`` are sums over the labels, by the names of their
    samples.
    """
    yield ok("serves", f"{status['scenario']}, {status['law']} in {status['command']} mode, {status['link']}")
    yield _phase(status)
    ticks, late = status["ticks"], status["deadline_misses"]
    percentiles = ", ".join(f"{name} {us:.0f} µs" for name, us in status["lateness_us"].items() if us is not None)
    loop = f"{ticks} ticks, {late} begun after their deadline" + (f"; late by {percentiles}" if percentiles else "")
    yield ok_or_note("loop", late <= _LATE_SHARE * ticks, loop, loop, "hil doctor says what this machine lacks")
    for name, sentence in status["realtime"].items():
        if "refused" in sentence or "not granted" in sentence:
            yield note(name, sentence.removeprefix(f"{name}: "), "hil doctor says how to have it granted")
    yield from _link(status)
    yield _recording(status)
    yield from _clients(metrics)


def _phase(status: Mapping[str, Any]) -> Finding:
    phase, why = status["phase"], status["why"]
    sentence = phase if why is None else f"{phase}: {why}"
    if phase in ("fault", "estop"):
        return problem("robot", sentence, "end the cause, then hil ctl clear")
    if phase == "away":
        return problem("robot", sentence, "look at cable and power; the service reconnects by itself")
    return ok("robot", sentence) if why is None else note("robot", sentence, "see what it says")


def _link(status: Mapping[str, Any]) -> Iterator[Finding]:
    frames = status["frames"]
    rejected = sum(frames["rejected"].values())
    sentence = f"{frames['sent']} frames sent, {frames['received']} received, {rejected} rejected"
    is_clean = rejected <= _REJECTED_SHARE * frames["received"]
    yield ok_or_note("frames", is_clean, sentence, sentence, "look at cable, earth and bit rate")
    if (age_ms := status["feedback_age_ms"]) is not None and status["phase"] != "away":
        sentence = f"{age_ms:.1f} ms old"
        yield ok_or_note(
            "feedback", age_ms <= _OLD_MS, sentence, sentence, "look at the link; the robot is held meanwhile"
        )
    if status["recoveries"]:
        yield note("recoveries", f"the robot was lost and came back {status['recoveries']} times", "look at its cable")


def _recording(status: Mapping[str, Any]) -> Finding:
    lost = status["rows_dropped"] + status["rows_lost"]
    if status["recording_trouble"] is not None:
        return problem("recording", f"it cannot be written: {status['recording_trouble']}", "free space on its disk")
    sentence = f"to {status['recording']}" if status["recording"] is not None else "none"
    if lost:
        return note("recording", f"{sentence}; {lost} rows were lost since the service began", "look at disk and load")
    return ok("recording", sentence)


def _clients(metrics: Mapping[str, float]) -> Iterator[Finding]:
    if failures := metrics.get("hil_api_audit_failures_total"):
        yield problem("audit log", f"{failures:.0f} lines could not be written", "free space on its disk")
    else:
        yield ok("audit log", "every order was written")
    dropped = metrics.get("hil_api_connections_dropped_total", 0.0)
    sentence = f"{metrics.get('hil_api_live_clients', 0.0):.0f} on the WebSocket; {dropped:.0f} connections dropped"
    yield ok_or_note(
        "clients", not dropped, sentence, sentence, "somebody connects and sends no token; ss -tnp says who"
    )
