"""The truth socket, client against server in one process: what is refused is said, and no record is left out."""

import contextlib
from types import SimpleNamespace

import pytest

from firmware_protocol.generated.messages import State
from hil.core.errors import DeviceError
from hil.core.types import ZERO_WHEELS, Pose, PoseFix, Twist
from hil.robot.truth import TruthClient
from hil.robot.truth_server import TruthServer
from tests.processes import wait_for

MS = 1_000_000
VIEW = SimpleNamespace(set_point_rad_s=ZERO_WHEELS, command_age_ticks=0, state=State.ACTIVE)


def test_a_robot_that_takes_no_faults_says_so_at_the_begin():
    with (
        contextlib.closing(TruthServer("a scenario")) as server,
        contextlib.closing(TruthClient(server.url, "a scenario", reset=False)) as client,
        pytest.raises(DeviceError, match="this robot does not support faults"),
    ):
        client.begin(0)


def test_a_poll_that_waits_gives_every_record_that_came_meanwhile():
    with contextlib.closing(TruthServer("a scenario")) as server:

        def publish(*times_ms: int) -> None:
            for time_ms in times_ms:
                server.publish(PoseFix(time_ms * MS, Pose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0)), VIEW)

        def not_before() -> int:
            """Asked within the poll, when it has taken what was there."""
            publish(3, 4)
            return 4 * MS

        with contextlib.closing(TruthClient(server.url, "a scenario", reset=False, not_before=not_before)) as client:
            wait_for(lambda: server._clients)
            publish(1, 2)
            client.poll()
            assert [record.fix.time_ns // MS for record in client.taken] == [1, 2, 3, 4]
