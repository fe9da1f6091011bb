"""Where session nonces come from: the system's random source, or the seed of a lockstep run; never from the robot."""

import random
from itertools import islice, pairwise

import pytest

from firmware_protocol.generated import messages as m
from hil.runtime import bench
from tests.support.bare_node import BareNode


@pytest.mark.proves("R-ARM-5")
def test_in_real_time_nonces_come_from_the_systems_random_source() -> None:
    """Neither Python's generator nor the clock decides: the same seed gives others, and each value can come."""
    drawn = []
    for _ in range(2):
        random.seed(1)
        drawn.append(list(islice(bench._nonces(None), 4000)))
    assert drawn[0] != drawn[1]
    assert all(1 <= nonce <= 0xFFFF for nonces in drawn for nonce in nonces)
    assert {nonce & 0xF for nonce in drawn[0]} == set(range(16))
    assert all((one ^ other) & 0xF for one, other in pairwise(drawn[0])), "the robot would refuse SESSION_USED"
    assert len(set(drawn[0])) > 3700, "of 65535 about 3880 differ in 4000 draws"
    assert sum(nonce >> 15 for nonce in drawn[0]) == pytest.approx(2000, abs=250), "eight standard deviations"


@pytest.mark.proves("R-ARM-5")
def test_in_lockstep_nonces_come_from_the_seed_alone() -> None:
    first, again, other = (list(islice(bench._nonces(seed), 100)) for seed in (5, 5, 6))
    assert first == again != other
    assert all(1 <= nonce <= 0xFFFF for nonce in first)
    assert all((one ^ other) & 0xF for one, other in pairwise(first))


@pytest.mark.proves("R-RESET-2")
def test_the_robot_makes_no_nonce_of_its_own() -> None:
    """It has none to guess: after power-on none is announced, in force or cleared, and no request names one."""
    node = BareNode()
    assert (node.node.session_nonce, node.node.announced_nonce, node.node.cleared_nonce) == (0, 0, 0)
    node.tick(2000)
    assert {x.nonce for x in node.heard() if isinstance(x, m.Status)} == {0}
    with pytest.raises(ValueError, match=r"HOST_HEARTBEAT\.nonce = 0"):
        node.heartbeat(m.Request.IDLE, 0)
