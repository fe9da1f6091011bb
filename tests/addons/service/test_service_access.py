"""Access rights over the API, and the entries of the audit log, through real processes."""

import contextlib
import itertools
import json
import os
import signal
import stat
import sys
from collections import Counter, deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from hil.addons.service.api.access import NEEDED, OWNER, TOO_MANY, Access, Client, Role, read_clients
from hil.addons.service.api.audit import Audit
from hil.addons.service.messages import ORDERS, Action, Answer, route
from hil.core.errors import BadInputError
from tests.addons.service.test_service_api import BODIES
from tests.support.processes import hil, own_state, wait_for
from tests.support.service_testbed import ControlSide, served

if sys.platform != "win32":
    import resource

TOKENS = {role: f"{role}-0123456789abcdef" for role in Role}
PANEL = Client("panel", frozenset({Role.DRIVE}), "127.0.0.1:4711")


@pytest.fixture(scope="module")
def of_many(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ControlSide]:
    folder = tmp_path_factory.mktemp("access")
    clients = folder / "clients"
    clients.touch(0o600)
    clients.write_text("# who\n" + "".join(f"{role}er {role} {token}\n" for role, token in TOKENS.items()))
    with own_state(folder), served(clients_file=str(clients), audit=str(folder / "audit.jsonl")) as side:
        yield side


def give(side: ControlSide, role: Role, action: Action) -> int:
    method, path = route(action)
    body = {"json": BODIES[path]} if method == "POST" and path in BODIES else {}
    told = {"Authorization": f"Bearer {TOKENS[role]}", "X-Forwarded-For": "192.0.2.1"}  # a client may claim any address
    return side.in_time(method, path, headers=told, **body).status_code


def lines(file: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in file.read_text().splitlines()]


def test_each_role_may_do_what_the_table_says_and_nothing_else(of_many: ControlSide) -> None:
    of_many.forget()
    may = {
        Role.READ: {Action.ESTOP},
        Role.DRIVE: {Action.ESTOP} | {action for action, role in NEEDED.items() if role is Role.DRIVE},
        Role.RECORD: {Action.ESTOP, Action.RECORD, Action.STOP_RECORDING},
        Role.ADMINISTER: set(Action),
    }
    assert Action.GAINS not in may[Role.DRIVE]
    for role, action in itertools.product(Role, Action):
        of_many.orders.clear()
        expected = 200 if action in may[role] else 403
        assert give(of_many, role, action) == expected, (role, action)
        assert of_many.actions == ([action] if expected == 200 else [])
    for path in ("/v1/status", "/metrics", "/openapi.json"):
        assert of_many.request("GET", path, headers={"Authorization": f"Bearer {TOKENS[Role.RECORD]}"}).is_success


def test_the_websocket_has_the_roles_of_its_token(of_many: ControlSide) -> None:
    of_many.forget()
    with of_many.live({"Authorization": f"Bearer {TOKENS[Role.READ]}"}) as live:

        def give_and_hear(action: Action) -> str | None:
            live.send(json.dumps({"order": {"number": 7, "action": action}}))
            return next(got["answer"] for text in live if "answer" in (got := json.loads(text)))["refused"]

        assert "needs the role drive, which the token 'reader' lacks" in str(give_and_hear(Action.ARM))
        assert give_and_hear(Action.ESTOP) is None
    assert of_many.actions == [Action.ESTOP]


def test_a_changed_clients_file_is_read_again_and_a_token_that_is_gone_ends(tmp_path: Path) -> None:
    clients = tmp_path / "clients"
    clients.touch(0o600)
    clients.write_text(f"panel drive {TOKENS[Role.DRIVE]}\n")
    with own_state(tmp_path), served(clients_file=str(clients)) as side:
        header = {"Authorization": f"Bearer {TOKENS[Role.DRIVE]}"}
        with side.live(header) as live:
            clients.write_text("panel drive\n")  # cannot be used: nothing changes
            wait_for(lambda: give(side, Role.DRIVE, Action.ARM) == 200)
            clients.write_text(f"panel read {TOKENS[Role.DRIVE]}\n")
            wait_for(lambda: give(side, Role.DRIVE, Action.ARM) == 403)
            live.send(json.dumps({"order": {"number": 7, "action": "arm"}}))
            answer = next(got["answer"] for text in live if "answer" in (got := json.loads(text)))
            assert "needs the role drive" in answer["refused"]
            clients.write_text(f"other read {TOKENS[Role.READ]}\n")
            wait_for(lambda: give(side, Role.DRIVE, Action.ARM) == 401)
            with pytest.raises(ConnectionClosed, match="its token is not valid any more"):
                deque(iter(lambda: live.recv(timeout=30.0), None), 0)
        assert side.request("GET", "/v1/status", headers={"Authorization": f"Bearer {TOKENS[Role.READ]}"}).is_success
        assert side.request("GET", "/v1/status").is_success, "the service's own token stays"


def test_requests_without_a_valid_token_are_counted(of_many: ControlSide) -> None:
    def unknown() -> float:
        text = of_many.request("GET", "/metrics").text
        return float(next(line for line in text.splitlines() if 'dropped_total{cause="unknown"}' in line).split()[1])

    before = unknown()
    for headers in ({}, {"Authorization": "Bearer wrong"}, {"Authorization": f"Bearer {TOKENS[Role.DRIVE][:-1]}"}):
        assert of_many.request("POST", "/v1/arm", headers=headers).status_code == 401
    assert unknown() == before + 3


def test_hil_ctl_says_which_role_a_token_lacks(of_many: ControlSide, tmp_path: Path) -> None:
    of_many.forget()
    file = tmp_path / "token"
    file.touch(0o600)
    file.write_text(TOKENS[Role.RECORD])
    which = ("ctl", "--url", of_many.child.url, "--token-file", file)
    refused = hil(*which, "arm")
    assert (refused.returncode, "the token 'recorder' lacks" in refused.stderr) == (2, True), refused.stderr
    assert hil(*which, "estop").returncode == 0


def test_too_many_orders_are_refused_but_none_that_stops(of_many: ControlSide) -> None:
    of_many.forget()
    twist = json.dumps({"order": {"number": 7, "action": "twist", "arguments": BODIES["/v1/twist"]}})
    with of_many.live({"Authorization": f"Bearer {TOKENS[Role.DRIVE]}"}) as live:

        def refusals() -> set[str]:
            for _ in range(200):
                live.send(twist)
            answers = (got["answer"] for text in live if "answer" in (got := json.loads(text)))
            return {answer["refused"] for answer in itertools.islice(answers, 200)}

        wait_for(lambda: TOO_MANY in refusals())
    assert [give(of_many, Role.DRIVE, action) for action in (Action.ESTOP, Action.STOP, Action.DISARM)] == 3 * [200]
    assert give(of_many, Role.ADMINISTER, Action.TWIST) == 200, "another client's"


@pytest.mark.slow
def test_a_token_that_may_only_read_takes_no_more_than_its_share(of_many: ControlSide) -> None:
    of_many.forget()
    reads = {"Authorization": f"Bearer {TOKENS[Role.READ]}"}
    with contextlib.ExitStack() as opened:
        for _ in range(16):
            opened.enter_context(of_many.live(reads))
        with pytest.raises(InvalidStatus, match="503"), of_many.live(reads):
            pass
        with of_many.live() as owner:
            owner.recv(timeout=30.0)
    statuses = Counter(of_many.request("GET", "/metrics", headers=reads).status_code for _ in range(100))
    assert statuses[200] >= 20, "those that scrape stay far below"
    assert statuses[429]
    assert of_many.request("GET", "/metrics").status_code == 200


def test_every_order_is_in_the_audit_log_with_who_gave_it_and_what_came_of_it(tmp_path: Path) -> None:
    clients, audit = tmp_path / "clients", tmp_path / "audit.jsonl"
    clients.touch(0o600)
    clients.write_text(f"panel drive {TOKENS[Role.DRIVE]}\n")
    with own_state(tmp_path), served(clients_file=str(clients), audit=str(audit)) as side:
        for method, path in ORDERS:
            assert side.in_time(method, path, **({"json": BODIES[path]} if path in BODIES else {})).is_success
        side.refuse("the robot is disarmed; arm it first")
        assert give(side, Role.DRIVE, Action.GO) == 409
        assert give(side, Role.DRIVE, Action.GAINS) == 403
        assert side.request("POST", "/v1/go", json={"x_m": "far"}).status_code == 422
        found = [line for line in lines(audit) if line["outcome"] != "unanswered"]
        assert stat.S_IMODE(audit.stat().st_mode) == 0o600
    assert [line["action"] for line in found if line["outcome"] == "accepted"] == [a.value for a in ORDERS.values()]
    given = {line["order"]: line for line in found if line["outcome"] == "given"}
    for line in found:
        if line["outcome"] == "accepted":
            assert (given[line["order"]]["action"], line["token"]) == (line["action"], "owner")
    assert next(line for line in given.values() if line["action"] == "go")["arguments"] == {
        "x_m": 1.0, "y_m": -2.0, "heading_rad": 3.0,
    }  # fmt: skip
    *_, refused, forbidden, invalid = found
    assert (refused["outcome"], refused["why"], refused["token"]) == (
        "refused",
        "the robot is disarmed; arm it first",
        "panel",
    )
    assert (forbidden["outcome"], forbidden["action"], invalid["outcome"]) == ("forbidden", "gains", "invalid")
    assert all(line["client"].startswith("127.0.0.1:") and line["time"].endswith("Z") for line in found)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_a_killed_api_process_has_written_every_order_that_it_gave(tmp_path: Path) -> None:
    audit = tmp_path / "audit.jsonl"
    with own_state(tmp_path), served(audit=str(audit)) as side:

        def killed(order: Any) -> Answer:
            if order.action is Action.GO:
                os.kill(side.child.pid or 0, signal.SIGKILL)
            return Answer(order.number)

        side.answer = killed
        with pytest.raises(Exception, match=r"disconnected|reset|closed"):
            side.request("POST", "/v1/go", json=BODIES["/v1/go"])
        wait_for(lambda: side.child.restarts and side.child.alive)
        side.wait_until_it_answers()
        assert side.request("POST", "/v1/arm").is_success
        found = [(line["action"], line["outcome"]) for line in lines(audit)]
    assert found == [("go", "given"), ("arm", "given"), ("arm", "accepted")]


def test_a_full_file_is_numbered_and_one_that_was_moved_is_begun_anew(tmp_path: Path) -> None:
    file = tmp_path / "audit.jsonl"
    audit = Audit(file, longest_bytes=1000, kept=3)
    for number in range(20):
        audit.note(PANEL, Action.ARM, "given", number=number)
    files = sorted(tmp_path.iterdir(), key=lambda one: one.stat().st_mtime_ns)
    kept = [line["order"] for one in files for line in lines(one)]
    assert kept == list(range(20)), "no line is lost while there are no more files than are kept"
    file.rename(tmp_path / "moved")
    audit.note(PANEL, Action.DISARM, "given", number=99)
    assert [line["order"] for line in lines(file)] == [99]
    for number in range(100):
        audit.note(PANEL, Action.ARM, "given", number=number)
    audit.close()
    assert len(list(tmp_path.glob("audit.jsonl*"))) == 4


def test_nine_older_files_are_kept_where_nothing_else_is_said(tmp_path: Path) -> None:
    audit = Audit(tmp_path / "audit.jsonl", longest_bytes=1)
    for number in range(15):
        audit.note(PANEL, Action.ARM, "given", number=number)
    audit.close()
    assert {path.name for path in tmp_path.iterdir()} == {"audit.jsonl", *(f"audit.jsonl.{n}" for n in range(1, 10))}


@pytest.mark.parametrize("role", Role)
def test_a_role_may_give_its_own_orders_whoever_may_read_an_emergency_stop_and_an_administrator_all(role: Role) -> None:
    may = {action for action in Action if Client("one", frozenset({role})).may(action)}
    own = {action for action in Action if NEEDED[action] is role}
    assert may == (set(Action) if role is Role.ADMINISTER else {Action.ESTOP} | own)


def test_long_arguments_are_cut_and_the_line_says_by_how_much(tmp_path: Path) -> None:
    audit = Audit(tmp_path / "audit.jsonl")
    long = {"reference": {"kind": "circle", "file": "é" * 5000}}
    audit.note(PANEL, Action.TRACK, "given", number=1, arguments=long)
    audit.note(PANEL, Action.TRACK, "given", number=2, arguments={"here": True})
    audit.close()
    cut, whole = lines(tmp_path / "audit.jsonl")
    assert cut["arguments"] == json.dumps(long)[:2000]
    assert cut["arguments_cut"] == len(json.dumps(long)) - 2000
    assert (whole["arguments"], "arguments_cut" in whole) == ({"here": True}, False)


def test_a_series_is_summed_up_and_no_order_of_it_is_lost(tmp_path: Path) -> None:
    audit = Audit(tmp_path / "audit.jsonl")
    for _ in range(50):
        audit.note(PANEL, Action.TWIST, "accepted", in_series=True)
    audit.note(PANEL, Action.TWIST, "refused", why="away", in_series=True)
    audit.close()
    told = [(line["outcome"], line.get("count", 1)) for line in lines(tmp_path / "audit.jsonl")]
    assert told == [("accepted", 1), ("refused", 1), ("accepted", 49)]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no RLIMIT_FSIZE")
def test_a_full_disk_is_counted_and_said_and_the_next_line_is_whole(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    audit = Audit(tmp_path / "audit.jsonl")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (9, before[1]))
    audit.note(PANEL, Action.ARM, "given", number=1)
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    audit.note(PANEL, Action.ARM, "given", number=2)
    audit.close()
    assert audit.failures == 1
    assert "audit log cannot be written" in caplog.text
    cut, whole = (tmp_path / "audit.jsonl").read_text().splitlines()
    assert (len(cut), json.loads(whole)["order"]) == (9, 2)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("panel drive short", "expected NAME ROLE"),
        ("panel drive", "expected NAME ROLE"),
        ("pa/nel drive 0123456789abcdef", "expected NAME ROLE"),
        ("panel drvie 0123456789abcdef", "line 1: no role 'drvie'; did you mean 'drive'"),
        ("owner read 0123456789abcdef", "'owner' or its token is there already"),
        ("a read 0123456789abcdef\n\nb read 0123456789abcdef", "line 3: 'b' or its token is there already"),
    ],
)
def test_a_line_of_the_clients_file_that_cannot_be_is_named(tmp_path: Path, text: str, part: str) -> None:
    file = tmp_path / "clients"
    file.touch(0o600)
    file.write_text(text)
    with pytest.raises(BadInputError, match=part):
        read_clients(file)


def test_a_service_whose_clients_file_others_may_read_does_not_start(tmp_path: Path) -> None:
    file = tmp_path / "clients"
    file.write_text("panel drive 0123456789abcdef")
    file.chmod(0o640)
    with own_state(tmp_path), pytest.raises(BadInputError, match="others may read it"), served(clients_file=str(file)):
        pytest.fail("it is served")


def test_a_client_with_the_services_own_token_is_refused() -> None:
    own = "0123456789abcdef"
    with pytest.raises(BadInputError, match="'panel' has the service's own token"):
        Access(own, {own: PANEL})


@pytest.mark.parametrize(
    ("shown", "name"),
    [
        ([b"Bearer 0123456789abcdef"], OWNER),
        ([b"bearer 0123456789abcdef"], OWNER),  # as RFC 9110 has it: the scheme has no case
        ([b"BEARER another-0123456789"], PANEL.name),
        ([b"Bearer 0123456789ABCDEF"], None),
        ([b"Basic 0123456789abcdef"], None),
        ([b"Bearer0123456789abcdef"], None),
        ([b"Bearer "], None),
        ([b"Bearer 0123456789abcdef", b"Basic x"], None),
        ([], None),
    ],
)
def test_a_token_is_shown_once_with_the_scheme_in_any_case(shown: list[bytes], name: str | None) -> None:
    access = Access("0123456789abcdef", {"another-0123456789": PANEL})
    found = access.client([(b"authorization", value) for value in shown])
    assert (found and found.name) == name


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no such pipes")
def test_an_audit_log_that_is_no_file_is_refused_and_left_as_it_is(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe, 0o622)
    mode = stat.S_IMODE(pipe.stat().st_mode)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)  # without one the system itself refuses
    with pytest.raises(BadInputError) as refused:
        Audit(pipe)
    os.close(reader)
    why = "it cannot be written (it is no regular file); name another by --audit"
    assert str(refused.value) == f"audit log {pipe}: {why}"
    assert stat.S_IMODE(pipe.stat().st_mode) == mode


def test_a_log_that_cannot_be_renamed_keeps_its_older_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "audit.jsonl"
    rename = Path.replace

    def renamed(one: Path, to: Path) -> Path:
        if one == file:
            raise PermissionError(1, "not permitted")  # as of a file that may only be appended to
        return rename(one, to)

    monkeypatch.setattr(Path, "replace", renamed)
    audit = Audit(file, longest_bytes=1, kept=5)
    for number in (1, 2, 3):
        file.with_name(f"audit.jsonl.{number}").write_text(str(number))
    for _ in range(8):
        audit.note(PANEL, Action.STOP, "given")
    audit.close()
    assert len(lines(file)) == 8
    assert sorted(one.read_text() for one in tmp_path.glob("audit.jsonl.*")) == ["1", "2", "3"]


def test_the_audit_log_is_in_the_state_folder_by_default(side: ControlSide) -> None:
    assert side.request("POST", "/v1/arm").is_success
    port = urlsplit(side.child.url).port
    file = Path(os.environ["XDG_STATE_HOME"]) / f"mecanum-hil/audit/{port}.jsonl"
    assert lines(file)[-1]["action"] == "arm"
