"""A node over a service in real time: clients that die, flood, or come late. The service's own status tells."""

import re
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from hil.addons.service.client import Client, find
from hil.addons.service.discovery import running
from hil.addons.service.messages import Action
from tests.support.processes import HIL, environment, is_running, own_state, wait_for
from tests.support.ros2_testbed import Peer, needs_ros, node, twist

pytestmark = [pytest.mark.alone, needs_ros]
SERVED = ("circle_speed", "--mode", "realtime", "--set", "loop.rate_hz=100")


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Any, Peer, Client, int]]:
    """A node over a service of its own, another node beside it, a client of the service, and the service's process."""
    folder = tmp_path_factory.mktemp("served")
    with own_state(folder / "state"):
        peer = Peer("")
        try:
            peer.listen("odom", "diagnostics")
            with node(folder, *SERVED, ros=("-p", "publish_rate_hz:=50.0")) as process:
                wait_for(lambda: peer.phase() == "disarmed", 120.0)
                (service,) = running()
                yield process, peer, find(), service.pid
                process.kill()  # whatever became of it
                process.wait()
                wait_for(lambda: not is_running(service.pid))
        finally:
            peer.close()


def drive(peer: Peer, client: Client) -> None:
    peer.arm()
    peer.publish("cmd_vel", 50.0, **twist(0.3))
    wait_for(lambda: fastest(client) > 3.0)


def fastest(client: Client) -> float:
    return max(map(abs, client.status()["speed_rad_s"]))


def orders_given() -> float:
    """Return how many orders the only service has got, of all kinds and outcomes."""
    (service,) = running()
    token = Path(service.token_file).read_text(encoding="utf-8").strip()
    answer = httpx.get(f"{service.url}/metrics", headers={"Authorization": f"Bearer {token}"}, trust_env=False)
    return sum(float(number) for number in re.findall(r"^hil_api_orders_total\{.*\} (.*)$", answer.text, re.MULTILINE))


def test_another_node_that_floods_and_dies_takes_nobody_the_e_stop(served: Any) -> None:
    _, peer, client, _ = served
    peer.arm()
    flood = Peer("")
    flood.publish("cmd_vel", 2000.0, **twist(0.3))
    wait_for(lambda: fastest(client) > 3.0)
    given = orders_given()
    begin_s = time.monotonic()
    time.sleep(1.0)
    rate_hz = (orders_given() - given) / (time.monotonic() - begin_s)
    assert rate_hz < 130.0
    assert peer.call("estop")["success"]
    wait_for(lambda: client.status()["phase"] == "estop" and fastest(client) < 0.1)
    flood.close()
    assert peer.call("clear")["success"]
    wait_for(lambda: client.status()["phase"] == "disarmed")


def test_the_node_may_drive_and_no_more_and_is_not_the_only_client(served: Any) -> None:
    _, peer, client, service = served
    late = Peer("")  # a late joiner hears the robot too
    late.listen("odom", "diagnostics")
    wait_for(lambda: late.phase() == "disarmed" and late.count("odom") > 5)
    late.close()
    client.order(Action.ARM)
    wait_for(lambda: peer.phase() == "active")
    (announced,) = running()
    audit = Path(announced.token_file).parents[1] / "audit" / f"{announced.port}.jsonl"
    assert peer.call("disarm")["success"]
    wait_for(lambda: '"token": "ros2"' in audit.read_text(encoding="utf-8") and peer.phase() == "disarmed")
    assert announced.pid == service


def test_a_node_that_hangs_or_is_killed_stops_the_robot_and_its_service_ends_in_order(served: Any) -> None:
    process, peer, client, service = served
    drive(peer, client)
    process.send_signal(signal.SIGSTOP)
    begin_s = time.monotonic()
    wait_for(lambda: fastest(client) < 0.1, 10.0)
    assert time.monotonic() - begin_s < 3.0  # twist timeout and ramp are 0.5 s
    assert client.status()["task"] == "hold"
    process.send_signal(signal.SIGCONT)
    wait_for(lambda: fastest(client) > 3.0)
    process.kill()
    wait_for(lambda: not is_running(service), 20.0)
    assert not running()


def test_a_node_uses_the_service_that_port_names_and_leaves_it_running(tmp_path: Path, state_home: None) -> None:
    command = [*HIL, "serve", "circle_speed", "--set", "loop.rate_hz=100", "--set", "service.port=0"]
    peer = Peer("")
    with (
        (tmp_path / "service.log").open("w") as log,
        subprocess.Popen(command, env=environment(), cwd=tmp_path, stderr=log) as service,
    ):
        try:
            wait_for(lambda: service.poll() is not None or running(), 120.0)
            (announced,) = running()
            peer.listen("diagnostics")
            with node(tmp_path, *SERVED, "--port", str(announced.port)):
                wait_for(lambda: peer.phase() == "disarmed", 120.0)
                drive(peer, client := find(announced.url))
            # The node has gone, and its twist has timed out.
            wait_for(lambda: fastest(client) < 0.1)
            assert client.status()["task"] == "hold"
            assert service.poll() is None
        finally:
            peer.close()
            service.send_signal(signal.SIGINT)
            assert service.wait(timeout=60) == 0
