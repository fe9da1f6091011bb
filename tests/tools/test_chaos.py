"""The judge of tools.chaos sees what it is there for. CI also runs it for two minutes, and all has to be well."""

import random
import signal
import sys
from pathlib import Path

import pytest

if sys.platform != "linux":
    pytest.skip("chaos needs pseudo-terminals, prlimit and signals", allow_module_level=True)

from hil.addons.service.messages import Action
from tools.chaos.judge import Judge
from tools.chaos.world import KINDS, World, until

pytestmark = pytest.mark.alone
PATIENCE_S = 60.0


@pytest.fixture
def own_state(monkeypatch: pytest.MonkeyPatch) -> None:
    """Put back where services leave their tokens, which a world changes."""
    monkeypatch.setenv("XDG_STATE_HOME", "")


def test_a_board_that_drives_on_without_host_and_guardian_is_seen(own_state: None, tmp_path: Path) -> None:
    with World(KINDS["board"], tmp_path / "world", random.Random(1)) as world:
        judge = Judge(world)

        def drives() -> bool:
            status, client = judge.status(), world.client()
            if status is None or client is None:
                return False
            if status["phase"] == "disarmed":
                client.order(Action.ARM)
            elif status["phase"] == "active":
                client.order(Action.TWIST, {"vx_m_s": 0.3, "vy_m_s": 0.0, "yaw_rate_rad_s": 0.0})
            return judge.is_moving

        assert until(drives, PATIENCE_S)
        assert judge.trouble == []
        for process in world.processes()["guardian"]:
            process.send_signal(signal.SIGSTOP)  # a dead one the host would notice
        drives()  # nothing stops it from now on
        world.service.kill()
        world.service.wait()
        judge.must_stand = True
        assert until(lambda: judge.trouble, PATIENCE_S) == ["it moved though its host was dead or stopped"]
        judge.close()
        (world.folder / "tmp" / "left").touch()
        trouble = world.end()
    assert "left behind in the folder for temporary files: left" in trouble
    assert any(one.startswith("left behind in the state folder: ") and one.endswith(".token") for one in trouble)
