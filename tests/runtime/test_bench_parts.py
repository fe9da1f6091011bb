"""What the bench of a run asks for before the robot moves, with stand-ins for its parts."""

import itertools
import random
from types import SimpleNamespace as Values
from typing import Any

import pytest

from hil.core.errors import BadInputError
from hil.core.types import Pose
from hil.runtime.bench import Bench, _nonces
from hil.scenario import load

REAL = {"is_local": False, "has_truth": False, "has_power_stage": True, "is_hidden": True}


def bench(*, is_local: bool, has_truth: bool, has_power_stage: bool, is_hidden: bool) -> Any:
    identity = Values(has_power_stage=has_power_stage)
    return Values(
        device=Values(connect=lambda: identity),
        local=Values() if is_local else None,
        truth=Values() if has_truth else None,
        _has_hidden_wiring=is_hidden,
    )


def test_a_wiring_of_the_plant_is_refused_where_the_robot_is_real() -> None:
    with pytest.raises(BadInputError, match=r"^\[plant\.wiring\] wires a virtual robot, and this one is real; remove"):
        Bench.connect(bench(**REAL))
    for name, value in REAL.items():
        virtual = bench(**REAL | {name: not value})
        assert Bench.connect(virtual) is virtual.device.connect()


@pytest.mark.parametrize(
    ("sets", "fix", "pose"),
    [
        ([], Pose(5.0, 6.0, 0.5), Pose(0.8, -0.2, 0.0)),
        (["plant.fmu=./x.fmu"], Pose(5.0, 6.0, 0.5), Pose(5.0, 6.0, 0.5)),
        (["plant.fmu=./x.fmu"], None, Pose(0.0, 0.0, 0.0)),
    ],
)
def test_odometry_starts_where_the_scenario_says_or_else_where_the_robot_is(
    sets: list[str], fix: Pose | None, pose: Pose
) -> None:
    scenario = load("paper_circle", set=sets)
    truth = Values(poll=lambda: fix and Values(pose=fix))
    assert Bench.start_pose(Values(_scenario=scenario, truth=truth)) == pose  # type: ignore[arg-type]
    if fix is None:
        assert Bench.start_pose(Values(_scenario=scenario, truth=None)) == pose  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", [1, 2, None])
def test_the_nonce_of_a_session_differs_from_the_one_before_in_its_low_4_bits(seed: int | None) -> None:
    drawn, found = random.Random(seed), list(itertools.islice(_nonces(seed), 3000))
    assert all(one % 16 != other % 16 for one, other in itertools.pairwise(found))
    assert 0 < min(found) < max(found) < 0x10000
    if seed is not None:
        expected = [drawn.randrange(1, 0x10000)]
        while len(expected) < 3000:
            expected += [nonce for nonce in [drawn.randrange(1, 0x10000)] if (nonce - expected[-1]) % 16]
        assert found == expected, "as few as can be are left out"
