"""The API over HTTP: access, refusals, and the orders that reach the control process."""

import json
import stat
import subprocess
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from openapi_spec_validator import validate
from prometheus_client.parser import text_string_to_metric_families

from hil.addons.service.messages import Action, Answer, ApiConfig, Phase, Task
from hil.core.printable import printable
from tests.addons.service.test_service_live import UPGRADE
from tests.core.test_printable import EVIL, HARMFUL
from tests.support.processes import own_state, wait_for
from tests.support.service_testbed import LIMITS, STATUS, ControlSide, served

ROUTES = {
    ("GET", "/v1/status"): None,
    ("GET", "/metrics"): None,
    ("GET", "/openapi.json"): None,
    ("POST", "/v1/arm"): Action.ARM,
    ("POST", "/v1/disarm"): Action.DISARM,
    ("POST", "/v1/estop"): Action.ESTOP,
    ("POST", "/v1/clear"): Action.CLEAR,
    ("POST", "/v1/track"): Action.TRACK,
    ("POST", "/v1/go"): Action.GO,
    ("POST", "/v1/twist"): Action.TWIST,
    ("POST", "/v1/wheels"): Action.WHEELS,
    ("POST", "/v1/stop"): Action.STOP,
    ("POST", "/v1/gains"): Action.GAINS,
    ("POST", "/v1/record"): Action.RECORD,
    ("DELETE", "/v1/record"): Action.STOP_RECORDING,
    ("POST", "/v1/shutdown"): Action.SHUTDOWN,
}
BODIES = {
    "/v1/track": {"reference": {"kind": "circle", "radius_m": 0.5}, "here": True},
    "/v1/go": {"x_m": 1.0, "y_m": -2.0, "heading_rad": 3},
    "/v1/twist": {"vx_m_s": 0.5, "vy_m_s": 0.0, "yaw_rate_rad_s": -0.1},
    "/v1/wheels": {"command": "speed", "values": [1.0, -1.0, 40.0, 0.0], "sequence": 7},
    "/v1/gains": {"gains": {"kp": 2.0}},
    "/v1/record": {"name": "a.mcap"},
}
TWIST = BODIES["/v1/twist"]


def body(method: str, path: str) -> dict:
    return {"json": BODIES[path]} if method == "POST" and path in BODIES else {}


def test_every_route_is_in_the_document_and_in_this_table(side: ControlSide) -> None:
    document = side.request("GET", "/openapi.json").json()
    validate(document)
    told = {(method.upper(), path) for path, methods in document["paths"].items() for method in methods}
    assert told == ROUTES.keys() - {("GET", "/openapi.json")}
    schemas = document["components"]["schemas"]
    ranges = {
        (name, key): (one["minimum"], one["maximum"])
        for name in ("Twist", "Go")
        for key, one in schemas[name]["properties"].items()
    }
    assert ranges == {
        ("Twist", "vx_m_s"): (-2.0, 2.0),
        ("Twist", "vy_m_s"): (-2.0, 2.0),
        ("Twist", "yaw_rate_rad_s"): (-4.0, 4.0),
        ("Go", "x_m"): (-100.0, 100.0),
        ("Go", "y_m"): (-100.0, 100.0),
        ("Go", "heading_rad"): (-1000.0, 1000.0),
    }
    assert schemas["Twist"]["properties"]["vx_m_s"]["description"] == "forward [m/s]"
    wheels = schemas["Wheels"]["properties"]
    values, (sequence, _) = wheels["values"], wheels["sequence"]["anyOf"]
    assert (values["minItems"], values["maxItems"], values["items"]["minimum"], values["items"]["maximum"]) == (
        *(4, 4),
        *(-40.0, 40.0),
    )
    assert (sequence["minimum"], sequence["maximum"]) == (0, 2**53)


@pytest.mark.parametrize(("method", "path"), ROUTES)
def test_no_route_lets_anybody_in_without_the_token_or_under_a_foreign_name(
    side: ControlSide, method: str, path: str
) -> None:
    port = urlsplit(side.child.url).port
    wrong = [
        ({}, 401),
        ({"Authorization": "Bearer wrong"}, 401),
        ({"Authorization": side.headers["Authorization"].replace("Bearer ", "")}, 401),
        (side.headers | {"Host": "robot.example.com"}, 421),
        (side.headers | {"Host": f"robot.example.com:{port}"}, 421),
        (side.headers | {"Host": "127.0.0.1:1"}, 421),
        ({"Host": "robot.example.com"}, 421),
    ]
    for headers, expected in wrong:
        response = side.request(method, path, headers=headers, **body(method, path))
        assert (response.status_code, list(response.json())) == (expected, ["detail"]), headers
    assert side.orders == []
    allowed = side.request(method, path, headers=side.headers | {"Host": f"localhost:{port}"}, **body(method, path))
    assert allowed.status_code == 200
    assert "server" not in allowed.headers


def test_the_websocket_lets_nobody_in_without_the_token_or_under_a_foreign_name(side: ControlSide) -> None:
    for headers, expected in [({}, 401), (side.headers | {"Host": "robot.example.com"}, 421)]:
        response = side.request("GET", "/v1/live", headers=UPGRADE | headers)
        assert (response.status_code, list(response.json())) == (expected, ["detail"])


@pytest.mark.parametrize(("method", "path"), [route for route, action in ROUTES.items() if action])
def test_an_order_reaches_the_control_process_as_given_and_its_answer_comes_back(
    side: ControlSide, method: str, path: str
) -> None:
    side.answer = lambda order: Answer(order.number, result={"note": "there we go"})
    response = side.request(method, path, **body(method, path))
    assert (response.status_code, response.json()) == (200, {"result": {"note": "there we go"}})
    assert [order.action for order in side.orders] == [ROUTES[method, path]]
    assert side.orders[0].arguments == body(method, path).get("json", {})
    side.refuse("the robot is not armed; arm it first")
    response = side.request(method, path, **body(method, path))
    assert (response.status_code, response.json()) == (409, {"detail": "the robot is not armed; arm it first"})


@pytest.mark.parametrize("path", ["/v1/track", "/v1/gains", "/v1/record"])
def test_a_body_that_may_be_left_out_has_its_defaults(side: ControlSide, path: str) -> None:
    assert side.request("POST", path).status_code == 200
    assert not any(side.orders[0].arguments.values())


@pytest.mark.parametrize(
    ("path", "text", "part"),
    [
        ("/v1/twist", '{"vx_m_s": NaN, "vy_m_s": 0, "yaw_rate_rad_s": 0}', "vx_m_s = nan: it should be"),
        ("/v1/twist", '{"vx_m_s": 1e999, "vy_m_s": 0, "yaw_rate_rad_s": 0}', "vx_m_s = inf: it should be"),
        ("/v1/twist", '{"vx_m_s": 2.1, "vy_m_s": 0, "yaw_rate_rad_s": 0}', "vx_m_s = 2.1: it should be less than"),
        ("/v1/twist", '{"vx_m_s": "1", "vy_m_s": 0, "yaw_rate_rad_s": 0}', "vx_m_s = '1': it should be a valid number"),
        ("/v1/twist", '{"vx_m_s": true, "vy_m_s": 0, "yaw_rate_rad_s": 0}', "vx_m_s = True: it should be a"),
        ("/v1/twist", '{"vx_m_s": 1, "vy_m_s": 0}', "yaw_rate_rad_s is missing"),
        ("/v1/twist", '{"vx": 1, "vx_m_s": 1, "vy_m_s": 0, "yaw_rate_rad_s": 0}', "vx: unknown name"),
        ("/v1/twist", "[1, 2", "the body is not JSON"),
        ("/v1/twist", "", "the body is missing"),
        ("/v1/go", '{"x_m": -Infinity, "y_m": 0, "heading_rad": 0}', "x_m = -inf: it should be"),
        ("/v1/go", '{"x_m": 101, "y_m": 0, "heading_rad": 0}', "x_m = 101: it should be less than or equal to 100"),
        ("/v1/track", '{"reference": {"kind": "circle", "radius_m": NaN}}', "reference.radius_m"),
        ("/v1/track", '{"reference": {"radius_m": 1}}', "reference.kind is missing"),
        ("/v1/gains", '{"gains": {"kp": NaN}}', "gains.kp"),
        ("/v1/gains", '{"gains": {"kp": {"deep": 1}}}', "gains.kp"),
        ("/v1/gains", r'{"gains": {"kp": "\ud800"}}', "the body: a text in it is not Unicode"),
        ("/v1/gains", r'{"\udfff": {}}', "the body: a text in it is not Unicode"),
        ("/v1/twist", '{"vx_m_s": 1' + 400 * "0" + "}", "0…: it should be"),
        ("/v1/record", '{"name": "run.txt"}', "name = 'run.txt': it"),
    ],
)  # fmt: skip
def test_a_body_that_is_not_as_it_should_be_is_refused_with_a_sentence(
    side: ControlSide, path: str, text: str, part: str
) -> None:
    response = side.request("POST", path, content=text, headers=side.headers | {"Content-Type": "application/json"})
    assert response.status_code == 422
    assert part in response.json()["detail"]
    assert side.orders == []


NAMES = st.sampled_from(["reference", "kind", "here", "gains", "path", "x_m", "vx_m_s"]) | st.text(max_size=5)
TEXTS = st.text(st.characters() | st.characters(categories=["Cs"]), max_size=5)
SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | TEXTS
ANYTHING = st.recursive(
    SCALARS, lambda deeper: st.lists(deeper, max_size=3) | st.dictionaries(NAMES, deeper, max_size=4), max_leaves=12
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(list(BODIES)), ANYTHING)
def test_whatever_the_body_is_it_is_an_order_or_refused_with_a_sentence(
    side: ControlSide, path: str, anything: object
) -> None:
    taken = len(side.orders)
    text = json.dumps(anything)
    response = side.request("POST", path, content=text, headers=side.headers | {"Content-Type": "application/json"})
    assert response.status_code in (200, 422), response.text
    assert len(side.orders) - taken == (response.status_code == 200)
    if response.status_code == 422:
        assert response.json()["detail"]


UNREAD = [30_000 * b"[", b'{"gains": {"kp": 1' + 5000 * b"0" + b"}}", b"\xff\xfe\x00"]


@pytest.mark.parametrize("text", UNREAD)
def test_a_body_that_cannot_be_read_is_refused(side: ControlSide, text: bytes) -> None:
    response = side.request(
        "POST", "/v1/gains", content=text, headers=side.headers | {"Content-Type": "application/json"}
    )
    assert response.status_code == 400
    assert "the body cannot be read" in response.json()["detail"]
    assert side.orders == []


CONTENTS = (
    st.binary(max_size=40)
    | ANYTHING.map(lambda value: json.dumps(value).encode())
    | st.integers(1, 1100).map(lambda depth: depth * b"[" + depth * b"]")
    | st.sampled_from([*UNREAD, 70_000 * b"x", json.dumps(TWIST).encode()])
)
CONTENT_TYPES = st.sampled_from(
    [b"application/json", b"application/json; charset=\xff", b"application/x-www-form-urlencoded"]
) | st.from_regex(rb"[!-~][ -~\x80-\xff]{,20}", fullmatch=True).map(bytes.strip)


def test_any_bytes_under_any_content_type_are_answered_and_in_the_audit_log(tmp_path: Path) -> None:
    file, given_orders = tmp_path / "audit.jsonl", Counter[str]()
    with own_state(tmp_path), served(audit=str(file)) as side:

        @settings(max_examples=100)
        @given(
            st.sampled_from([route for route, action in ROUTES.items() if action]),
            CONTENTS,
            CONTENT_TYPES,
            st.sampled_from([f"127.0.0.1:{urlsplit(side.child.url).port}", "robot.example.com"]),
        )
        def give(route: tuple[str, str], content: bytes, content_type: bytes, host: str) -> None:
            headers = {"Authorization": side.headers["Authorization"], "Host": host, "Content-Type": content_type}
            response = side.request(*route, content=content, headers=headers)
            assert response.status_code < 500, response.text
            assert response.is_success or response.json()["detail"]
            given_orders[ROUTES[route]] += 1

        give()
    ended = [one for one in map(json.loads, file.read_text().splitlines()) if one["outcome"] != "given"]
    assert sum((Counter({one["action"]: one.get("count", 1)}) for one in ended), Counter()) == given_orders


def test_the_document_says_what_each_refusal_means(side: ControlSide) -> None:
    side.refuse("the robot is not armed; arm it first")
    as_json = side.headers | {"Content-Type": "application/json"}
    requests = [
        {"content": UNREAD[0], "headers": as_json},
        {"headers": {}},
        {"json": BODIES["/v1/go"]},
        {"content": json.dumps(BODIES["/v1/go"])},
        {"json": {"x_m": "far"}},
    ]
    codes = [side.request("POST", "/v1/go", **request).status_code for request in requests]
    told = side.request("GET", "/openapi.json").json()["paths"]["/v1/go"]["post"]["responses"]
    assert [told.pop(str(code))["description"] for code in codes] == [
        "The body cannot be read",
        "The token is missing or wrong",
        "The control process refuses: the order is not possible now",
        "The body was not sent as JSON",
        "The body is not valid",
    ]
    assert {code: one["description"] for code, one in told.items() if code != "200"} == {  # sent in other tests
        "403": "The token lacks the role that the order needs",
        "429": "Too many orders a second were given with this token",
        "503": "The control process has too many orders to answer, or is ending",
        "504": "The control process does not answer in time",
    }


def test_a_body_that_is_too_long_or_of_unknown_length_is_refused_unread(side: ControlSide) -> None:
    long = side.request("POST", "/v1/gains", content=b"x" * 70_000)
    why = "a body of 70000 bytes is too long; expected at most 65536"
    assert (long.status_code, long.json()) == (413, {"detail": why})
    chunked = side.request("POST", "/v1/gains", content=iter([b"{}"]))
    assert chunked.status_code == 411
    assert side.orders == []


def test_the_status_is_the_newest_and_fits_its_schema(side: ControlSide) -> None:
    status = side.request("GET", "/v1/status").json()
    assert status["phase"] == "active"
    assert status["pose"] == list(STATUS.pose or ())
    assert status["lateness_us"]["p99.9"] is None, "JSON has no NaN"
    side.status = replace(STATUS, phase=Phase.FAULT, task=None, why="encoder fl stands")
    wait_for(lambda: side.request("GET", "/v1/status").json()["why"] == "encoder fl stands")
    schema = side.request("GET", "/openapi.json").json()["components"]["schemas"]["Status"]
    assert set(status) == set(schema["properties"])


def test_texts_of_a_device_a_law_or_a_path_reach_a_client_without_control_characters(side: ControlSide) -> None:
    side.status = replace(STATUS, why=EVIL, link=EVIL, scenario=EVIL, realtime={"memory": EVIL})
    wait_for(lambda: "title" in str(side.request("GET", "/v1/status").json()["why"]))
    side.refuse(EVIL)
    refused = side.request("POST", "/v1/arm")
    assert refused.json() == {"detail": printable(EVIL)}
    with side.live() as live:
        pushed = str(live.recv(timeout=30.0))
    shown = [side.request("GET", path).text for path in ("/v1/status", "/metrics")]
    for text in (*shown, refused.text, pushed):
        assert "title" in text
        assert not HARMFUL.search(text)


def test_a_control_process_that_says_nothing_is_a_gateway_timeout(side: ControlSide) -> None:
    side.answer = lambda _order: None
    side.speaks = False
    response = side.request("POST", "/v1/arm")
    assert (response.status_code, "has not answered arm" in response.json()["detail"]) == (504, True)
    late = side.request("GET", "/v1/status")
    assert (late.status_code, "no status for" in late.json()["detail"]) == (504, True)


def test_an_emergency_stop_goes_through_when_nothing_else_does(side: ControlSide) -> None:
    side.answer = lambda _order: None
    with ThreadPoolExecutor(72) as pool:
        twists = [pool.submit(side.request, "POST", "/v1/twist", json=TWIST) for _ in range(72)]
        statuses = sorted(twist.result().status_code for twist in twists)
    assert statuses == [503] * 8 + [504] * 64
    side.answer = lambda order: Answer(order.number)
    assert side.request("POST", "/v1/stop").status_code == 503
    assert side.request("POST", "/v1/estop").status_code == 200
    side.answer_all()
    wait_for(lambda: side.request("POST", "/v1/stop").status_code == 200)


def test_the_metrics_are_what_the_status_says_in_base_units(side: ControlSide) -> None:
    side.request("POST", "/v1/clear")
    frames = {"sent": 10, "received": 9, "rejected": {"crc": 1, "cobs": 4}}
    late = {"p50": 51.0, "p99": float("nan"), "p99.9": 640.0}
    more = {"round_trip_ms": 2.5, "twist_age_s": 0.125, "rows_dropped": 6, "rows_lost": 7, "recording_trouble": "full"}
    side.status = replace(STATUS, task=Task.GO, power_stage=True, frames=frames, lateness_us=late, **more)
    wait_for(lambda: side.request("GET", "/v1/status").json()["rows_lost"] == 7)
    response = side.request("GET", "/metrics")
    assert response.headers["content-type"].startswith("text/plain")
    families = {family.name: family for family in text_string_to_metric_families(response.text)}
    assert all(family.documentation and family.type != "unknown" for family in families.values())
    assert families["hil_lateness_seconds"].type == "summary"
    of_process = ("hil_status_age_seconds", "hil_api_")
    samples = [one for family in families.values() for one in family.samples if not one.name.startswith(of_process)]
    states = {"hil_phase": (Phase, "active"), "hil_task": (Task, "go")}
    served = {"scenario": "paper_circle", "law": "pid", "command": "speed", "link": "serial:/dev/ttyACM0"}
    expected = [
        ("hil_service_info", served, 1.0),
        *(
            (name, {name: one.value}, float(one.value == now))
            for name, (every, now) in states.items()
            for one in sorted(every)
        ),
        ("hil_ticks_total", {}, 1234.0),
        ("hil_deadline_misses_total", {}, 2.0),
        ("hil_recoveries_total", {}, 1.0),
        ("hil_rows_dropped_total", {}, 6.0),
        ("hil_rows_lost_total", {}, 7.0),
        ("hil_frames_sent_total", {}, 10.0),
        ("hil_frames_received_total", {}, 9.0),
        ("hil_frames_rejected_total", {"cause": "cobs"}, 4.0),
        ("hil_frames_rejected_total", {"cause": "crc"}, 1.0),
        ("hil_feedback_age_seconds", {}, 0.0015),
        ("hil_round_trip_seconds", {}, 0.0025),
        ("hil_battery_volts", {}, 24.5),
        ("hil_twist_age_seconds", {}, 0.125),
        ("hil_power_stage", {}, 1.0),
        ("hil_recording", {}, 0.0),
        ("hil_recording_trouble", {}, 1.0),
        ("hil_lateness_seconds", {"quantile": "0.5"}, 51e-6),
        ("hil_lateness_seconds", {"quantile": "0.999"}, 640e-6),
        ("hil_lateness_seconds_count", {}, 1234.0),
    ]
    assert [(one.name, one.labels, pytest.approx(one.value)) for one in samples] == expected
    orders = {tuple(sample.labels.values()): sample.value for sample in families["hil_api_orders"].samples}
    assert orders["clear", "accepted"] >= 1
    assert 0.0 <= families["hil_status_age_seconds"].samples[0].value < 30.0
    side.status = STATUS
    wait_for(lambda: "hil_round_trip_seconds" not in side.request("GET", "/metrics").text)  # it is not known


def test_only_the_loopback_address_is_served(side: ControlSide) -> None:
    port = urlsplit(side.child.url).port
    with pytest.raises(httpx.TransportError):  # on Linux all of 127.0.0.0/8 is this machine
        httpx.get(f"http://127.0.0.2:{port}/v1/status", trust_env=False)


def test_the_token_is_new_long_and_for_this_user_only(side: ControlSide) -> None:
    path = side.child.token_file
    assert path is not None
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert len(path.read_text().strip()) >= 43, "32 bytes in base 64"
    assert json.loads(path.with_name(f"{urlsplit(side.child.url).port}.json").read_text())["token_file"] == str(path)


def test_an_error_beside_the_server_ends_the_api_process_so_that_another_is_started() -> None:
    broken = (
        "import sys\nfrom hil.addons.service import api_process\nfrom hil.addons.service.api.audit import Audit\n"
        "async def keep(self): raise RuntimeError('broken')\n"
        "Audit.keep = keep\nsys.exit(api_process.main())"
    )
    config = {"config": asdict(ApiConfig("a test", "a test", LIMITS, port=0))}
    command = [sys.executable, "-c", broken]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stderr is not None
        process.stdin.write(json.dumps(config).encode() + b"\n")
        process.stdin.flush()  # and it stays open
        text = process.stderr.read().decode()
        assert process.wait() == 1
    assert "API ends because of an error why=RuntimeError('broken')" in text
