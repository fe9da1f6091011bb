"""Parts of the API process in this one: orders after a stall, rates of tokens, and the files of the audit log."""

import asyncio
import json
import os
import sys
import time
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

import pytest

from hil.addons.service.api import control as control_module
from hil.addons.service.api.access import OWNER, Access, Client, ClientsFile, Role
from hil.addons.service.api.audit import Audit
from hil.addons.service.api.control import Control, NotDoneError
from hil.addons.service.messages import Action
from hil.core.json_lines import LineReader, LineWriter

if sys.platform != "win32":
    import resource

PANEL = Client("panel", frozenset({Role.DRIVE}), "127.0.0.1:4711")
STALLED = "the API stalled while this order waited; give it again"
TWIST_TIMEOUT_S = 0.05


def test_after_a_stall_nothing_moves_before_the_orders_that_waited_have_come(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("LIFE_PERIOD_S", "_CATCHING_UP_S", "ANSWER_S"):
        monkeypatch.setattr(control_module, name, 0.01)
    monkeypatch.setattr(control_module, "SILENT_S", 600.0)
    (own_read, other_write), (other_read, own_write) = os.pipe(), os.pipe()

    async def scenario() -> None:
        lines, writer = LineReader(own_read), LineWriter(own_write)
        control = Control(lines, writer, TWIST_TIMEOUT_S, Audit(tmp_path / "audit.jsonl"))
        living = asyncio.create_task(control.live())

        async def refusal(action: Action = Action.TWIST) -> str:
            with pytest.raises(NotDoneError) as refused:
                await control.order(action, {}, PANEL)
            return str(refused.value)

        time.sleep(TWIST_TIMEOUT_S + 0.05)  # the stall itself
        heard = {await refusal()}
        until_s = time.monotonic() + 0.1
        while time.monotonic() < until_s:  # a burst of ten times what catching up takes
            heard.add(await refusal())
            for _ in range(10):
                await asyncio.sleep(0.0)
        assert heard == {STALLED}
        late = "the control process has not answered go within 0.01 s; it may still carry it out"
        assert await refusal(Action.GO) == late, "only a twist is out of date so soon"
        while await refusal() == STALLED:
            await asyncio.sleep(0.02)
        living.cancel()
        os.close(other_write)
        await control.gone.wait()

    asyncio.run(scenario())
    for end in (own_read, own_write, other_read):
        os.close(end)


def test_an_order_is_refused_that_waits_while_the_service_ends_or_comes_later(tmp_path: Path) -> None:
    (own_read, other_write), (other_read, own_write) = os.pipe(), os.pipe()

    async def refusals() -> list[str]:
        lines, writer = LineReader(own_read), LineWriter(own_write)
        control = Control(lines, writer, TWIST_TIMEOUT_S, Audit(tmp_path / "audit.jsonl"))
        waits = asyncio.create_task(control.order(Action.DISARM, {}, PANEL))
        await asyncio.sleep(0.0)
        os.close(other_write)
        await control.gone.wait()
        comes_later = control.order(Action.DISARM, {}, PANEL)
        return [str(refused) for refused in await asyncio.gather(waits, comes_later, return_exceptions=True)]

    assert asyncio.run(refusals()) == ["the service has ended", "the service is ending"]
    for end in (own_read, own_write, other_read):
        os.close(end)


async def until_logged(caplog: pytest.LogCaptureFixture, keeps: Coroutine[Any, Any, None]) -> dict[str, Any]:
    """Return what the first line of the log says while a task of the API runs, its event and its fields."""
    task = asyncio.create_task(keeps)
    while not caplog.records:
        await asyncio.sleep(0.001)
    task.cancel()
    return {"event": caplog.messages[0], **vars(caplog.records[0])["fields"]}


def test_a_clients_file_that_cannot_be_used_any_more_is_told_and_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("hil.addons.service.api.access._REFRESH_S", 0.001)
    path = tmp_path / "clients"
    path.touch(0o600)
    path.write_text("panel drive another-0123456789\n")
    clients = ClientsFile(path)
    access = Access("0123456789abcdef", clients.others)
    path.unlink()
    said = asyncio.run(until_logged(caplog, clients.keep(access)))
    assert said["event"] == "clients file cannot be used; the clients from before stay"
    assert said["why"].startswith(f"clients file {path}: ")
    assert access.client([(b"authorization", b"Bearer another-0123456789")]) is not None


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no RLIMIT_NOFILE")
def test_an_audit_log_that_is_not_on_the_disk_for_want_of_descriptors_is_told_and_gets_there_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("hil.addons.service.api.audit._SYNC_S", 0.001)
    synced: list[int] = []
    monkeypatch.setattr("hil.addons.service.api.audit._sync", synced.extend)
    audit = Audit(tmp_path / "audit.jsonl")
    audit.note(PANEL, Action.ARM, "given")
    before = resource.getrlimit(resource.RLIMIT_NOFILE)

    async def kept() -> dict[str, Any]:
        resource.setrlimit(resource.RLIMIT_NOFILE, (1, before[1]))
        said = await until_logged(caplog, audit.keep())
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
        keeps = asyncio.create_task(audit.keep())
        while not synced:
            await asyncio.sleep(0.001)
        keeps.cancel()
        return said

    said = {"event": "audit log is not on the disk", "path": tmp_path / "audit.jsonl", "why": "Too many open files"}
    assert asyncio.run(kept()) == said
    os.close(*synced)


def test_tokens_have_their_own_rates_and_what_stops_or_the_owner_reads_has_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_s = 100.0
    monkeypatch.setattr("hil.addons.service.logs.time.monotonic", lambda: now_s)
    other = Client("other", frozenset({Role.READ}))
    access = Access("0123456789abcdef", {"a" * 16: PANEL, "b" * 16: other})

    def orders(client: Client, action: Action, number: int) -> int:
        return sum(access.is_in_time(client, action) for _ in range(number))

    def reads(client: Client, path: str, number: int) -> int:
        return sum(access.may_read(client, path) for _ in range(number))

    assert orders(PANEL, Action.TWIST, 210) == 200
    assert [orders(PANEL, action, 300) for action in (Action.ESTOP, Action.STOP, Action.DISARM)] == 3 * [300]
    assert orders(other, Action.TWIST, 10) == 10
    now_s += 0.125
    assert orders(PANEL, Action.ARM, 30) == 25
    assert (reads(PANEL, "/metrics", 21), reads(PANEL, "/v1/status", 1)) == (20, 0)
    now_s += 0.125
    assert reads(PANEL, "/v1/status", 20) == 12
    owner = Client(OWNER, frozenset(Role))
    assert reads(owner, "/metrics", 300) == 300
    rates = access.rates(PANEL)
    access.replace({"c" * 16: PANEL._replace(roles=frozenset({Role.READ}))})
    assert access.rates(PANEL) is rates, "a token that is replaced has not become faster"
    assert access.rates(other) is not access.rates(other), "one that is gone is not remembered"


def test_a_file_is_full_at_its_length_and_arguments_are_cut_beyond_theirs(tmp_path: Path) -> None:
    file = tmp_path / "audit.jsonl"
    audit = Audit(file)
    for length in (1980, 1981):
        audit.note(PANEL, Action.RECORD, "given", arguments={"name": "x" * (length - len('{"name": ""}') + 20)})
    audit.close()
    whole, cut = (json.loads(line) for line in file.read_text().splitlines())
    assert (len(json.dumps(whole["arguments"])), "arguments_cut" in whole) == (2000, False)
    assert (len(cut["arguments"]), cut["arguments_cut"]) == (2000, 1)
    file.unlink()
    audit = Audit(file)
    audit.note(PANEL, Action.STOP, "given")
    length = file.stat().st_size
    audit.close()
    audit = Audit(file, longest_bytes=2 * length, kept=2)
    for _ in range(6):
        audit.note(PANEL, Action.STOP, "given")
    audit.close()
    sizes = {one.name: one.stat().st_size // length for one in tmp_path.iterdir()}
    assert sizes == {"audit.jsonl": 1, "audit.jsonl.1": 2, "audit.jsonl.2": 2}
