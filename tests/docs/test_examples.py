"""The profiles of hypothesis, the share of them that a test takes, and the seed of the examples."""

import pytest
from hypothesis import given, settings, strategies

from tests.support.examples import load_profile, share_of_examples


@pytest.mark.parametrize(("profile", "whole"), [("quick", 50), ("usual", 100), ("thorough", 1000)])
def test_a_share_is_of_the_examples_that_the_profile_has(profile: str, whole: int, monkeypatch: pytest.MonkeyPatch):
    with monkeypatch.context() as patch:
        patch.setenv("HIL_EXAMPLES", profile)
        load_profile()
        found = [settings().max_examples, share_of_examples(0.3).max_examples, share_of_examples(0.0001).max_examples]
    load_profile()
    assert found == [whole, 0.3 * whole, 1]


def test_a_profile_that_is_none_is_refused_with_the_names_of_those_that_are(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("HIL_EXAMPLES", "slow")
    with pytest.raises(SystemExit, match="HIL_EXAMPLES=slow: unknown; expected quick, usual or thorough"):
        load_profile()


def test_a_seed_chooses_the_examples(monkeypatch: pytest.MonkeyPatch):
    def drawn(seed: str) -> list[int]:
        monkeypatch.setenv("HIL_SEED", seed)
        load_profile()
        numbers: list[int] = []

        @settings(database=None)
        @given(strategies.integers())
        def draw(number: int) -> None:
            numbers.append(number)

        draw()
        return numbers

    try:
        every = [drawn(seed) for seed in ("1", "1", "2", "", "")]
    finally:
        monkeypatch.undo()
        load_profile()
    assert every[0] == every[1]
    assert every[3] == every[4]
    assert every[0] != every[2] != every[3] != every[0]
