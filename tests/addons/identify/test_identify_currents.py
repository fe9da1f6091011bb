"""Currents of hil identify without their sensors' noise: only where the motors followed their commands."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.generated.messages import TorqueCommand
from hil.addons.identify.currents import Regression, fewest_lags, quiet
from hil.addons.identify.drives import Drive, as_sent
from hil.scenario import load
from tests.support.examples import share_of_examples

ROWS, NOISE_A, CONSTANT = 6000, 0.03, 1.3
GAINS = np.array([1.0, 1.02, 0.97, 1.01])
OFFSET_A = 0.05


def drive_of_torques(seed: int, delay: int = 2) -> tuple[Drive, np.ndarray]:
    """Return a drive whose motors follow after a delay, measured with noise, and the currents without the noise."""
    random = np.random.default_rng(seed)
    time_s = np.arange(ROWS, dtype=np.float64) * 0.005
    phases = random.uniform(0.0, 6.0, (5, 4))
    command = sum(0.1 * np.sin(7.0 * (one + 1) * time_s[:, None] + phases[one]) for one in range(5))
    true = np.pad(GAINS * command / CONSTANT, ((delay, 0), (0, 0)))[:ROWS] + OFFSET_A
    measured = true + random.normal(0.0, NOISE_A, true.shape)
    command[:2] = np.nan
    nothing = np.full((ROWS, 3), np.nan)
    drive = Drive(
        Path("floor.rrd"), load("circle_speed").robot, {}, 0.005, time_s, np.zeros((ROWS, 4)), measured, command,
        np.zeros(ROWS), np.zeros((0, 4)), nothing, 0.0,
    )  # fmt: skip
    return drive, true


def test_commands_that_were_followed_replace_the_noise_and_keep_gain_offset_and_delay() -> None:
    (first, _), (second, _), (judge, true) = (drive_of_torques(seed) for seed in (1, 2, 3))
    found = quiet([first, second], judge)
    assert found.sentences == ()
    off = found.drives[-1].current_a[10:] - true[10:]
    assert off.std() < NOISE_A / 20
    # The doubt of the gains follows from the noise over all that was driven.
    gains = np.sum(found.drives[0].current_a * found.drives[0].current_a, axis=0)
    assert np.sqrt(found.gain_variance) == pytest.approx(NOISE_A / np.sqrt(gains), rel=0.3)


def test_a_motor_at_its_limit_is_taken_as_it_was_measured() -> None:
    (first, _), (judge, _) = drive_of_torques(4), drive_of_torques(5)
    limited = replace(first, current_a=np.clip(first.current_a, -0.12, 0.12))
    found = quiet([limited], judge)
    assert np.array_equal(found.drives[0].current_a, limited.current_a)
    assert found.sentences[0].startswith("floor.rrd: the currents of fl, fr, rr, rl are not what was commanded")
    assert not found.gain_variance.any()


def test_a_drive_that_strays_is_left_out_and_the_others_are_not() -> None:
    (first, _), (second, _), (judge, _) = (drive_of_torques(seed) for seed in (6, 7, 8))
    stuck = second.current_a.copy()
    stuck[3000:3400, 1] = 0.0  # a second and more without the second motor
    found = quiet([first, replace(second, current_a=stuck)], judge)
    assert np.array_equal(found.drives[1].current_a[:, 1], stuck[:, 1])
    assert np.abs(found.drives[1].current_a[:, 0] - stuck[:, 0]).max() > 1e-3
    assert len(found.sentences) == 1
    assert "the currents of fr are not" in found.sentences[0]


def test_a_drive_without_torque_commands_is_silently_as_measured() -> None:
    first, _ = drive_of_torques(9)
    by_speed = replace(first, torque_command_n_m=np.full((ROWS, 4), np.nan))
    found = quiet([by_speed], by_speed)
    assert np.array_equal(found.drives[0].current_a, first.current_a)
    assert found.sentences == ()


def regressions_of(delays_rows: Sequence[float], seed: int) -> list[Regression]:
    """Return regressions of motors with these delays, on commands with the noise of a loop, over two minutes."""
    random = np.random.default_rng(seed)
    found = []
    for gain, delay in zip(GAINS, delays_rows, strict=True):
        smooth = np.convolve(random.normal(0.0, 0.3, 24_000), np.hanning(80), "same") / 6.0
        command = smooth + random.normal(0.0, 0.02, smooth.shape)
        lagged = np.stack([np.roll(command, lag) for lag in range(6)], axis=1)
        whole, share = int(delay), delay - int(delay)
        # A command is held until the next one, so a delay of part of a row mixes two of them in its mean.
        current = gain / CONSTANT * ((1.0 - share) * lagged[:, whole] + share * lagged[:, whole + 1])
        measured = current + random.normal(0.0, NOISE_A, current.shape)
        factors = np.linalg.lstsq(lagged, measured, rcond=None)[0]
        left = measured - lagged @ factors
        found.append(Regression(factors, lagged.T @ lagged, float(left.var()), len(left)))
    return found


def delays_of(factors: Sequence[np.ndarray]) -> np.ndarray:
    return np.array([one @ np.arange(len(one)) / one.sum() for one in factors])


@share_of_examples(0.1)
@given(st.floats(0.0, 4.0), st.integers(0, 2**32))
def test_motors_on_one_board_are_late_by_the_same(delay: float, seed: int) -> None:
    found = fewest_lags(regressions_of([delay] * 4, seed))
    delays = delays_of(found)
    assert np.ptp(delays) < 1e-9, "delays that differ would look like a centre of mass that is off"
    assert delays[0] == pytest.approx(delay, abs=0.05)
    gains = np.array([one.sum() for one in found]) * CONSTANT
    assert gains == pytest.approx(GAINS, rel=0.01)


@share_of_examples(0.1)
@given(st.integers(0, 2**32))
def test_motors_that_are_late_by_different_times_are_told_apart(seed: int) -> None:
    delays = [1.0, 1.3, 1.6, 2.0]
    assert delays_of(fewest_lags(regressions_of(delays, seed))) == pytest.approx(delays, abs=0.12)


def test_without_any_motor_that_follows_there_are_no_lags() -> None:
    assert fewest_lags([]) == []


@given(torques=st.tuples(*[st.floats(-15.99, 15.99)] * 4))
def test_commands_count_as_the_wire_carried_them(torques: tuple[float, float, float, float]) -> None:
    """Rounded by 1/256 N·m, a light robot's commands were 1 mA of noise that seemed to move its centre of mass."""
    message = TorqueCommand(*torques, 0, 1)
    sent = TorqueCommand.decode(message.encode())
    assert sent is not None
    assert as_sent(np.array(torques)).tolist() == [sent.fl_n_m, sent.fr_n_m, sent.rr_n_m, sent.rl_n_m]
