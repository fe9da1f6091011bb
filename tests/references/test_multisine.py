"""The multisine by its spectrum: the tones of each axis, found by least squares, and the limit that scales them."""

import math

import numpy as np
import pytest

from hil.references.multisine import Multisine

REST_S = 2.0
T_S = np.arange(0.0, 120.0, 0.01)[:, None]


def tones_hz(source: Multisine, axis: int) -> np.ndarray:
    """Return the frequencies of an axis: one ladder with a constant factor, its rungs for x, y and heading in turn."""
    rungs = 3 * np.arange(source.tones) + axis
    return source.lowest_hz * (source.highest_hz / source.lowest_hz) ** (rungs / (3 * source.tones - 1))


def found(source: Multisine) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return angular frequencies, and amplitudes of the speed's cosines and sines, of each axis."""
    at_s = np.linspace(0.0, 100.0, 150)[1:, None]
    speeds = np.array([source.at(REST_S + t_s).twist for t_s in at_s[:, 0].tolist()])
    axes = []
    for axis in range(3):
        rate = math.tau * tones_hz(source, axis)
        waves = np.hstack([np.cos(rate * at_s), np.sin(rate * at_s)])
        amplitudes = np.linalg.lstsq(waves, speeds[:, axis], rcond=None)[0]
        assert waves @ amplitudes == pytest.approx(speeds[:, axis], abs=1e-9), "there is nothing else"
        axes.append((rate, *np.split(amplitudes, 2)))
    return axes


def test_the_speed_of_a_tone_falls_with_the_root_of_its_frequency_and_slow_ones_begin_at_their_fastest():
    axes = found(Multisine(rest_s=REST_S, ramp_s=0.0, tones=8, seed=5))
    sizes = [np.hypot(cosines, sines) * np.sqrt(rate) for rate, cosines, sines in axes]
    for size in sizes:
        assert size == pytest.approx(np.full(8, size[0]))
    slowest = [math.hypot(cosines[0], sines[0]) for _, cosines, sines in axes]
    assert slowest[0] == pytest.approx(slowest[1]), "x and y have one factor"
    for rate, cosines, sines in axes:
        slow = rate < 0.1 * math.tau
        assert slow.any()
        assert sines[slow] == pytest.approx(np.zeros(slow.sum()), abs=1e-9)
        assert (np.abs(sines[~slow]) > 1e-3 * np.abs(cosines[~slow])).all()


@pytest.mark.parametrize(
    ("which", "limits"),
    [
        ("speed", {"speed_m_s": 0.2}),
        ("acceleration", {"acceleration_m_s2": 0.4}),
        ("room", {"room_m": 0.6}),
        ("yaw_rate", {"yaw_rate_rad_s": 0.3}),
        ("yaw_acceleration", {"yaw_acceleration_rad_s2": 0.9}),
    ],
)
def test_the_limit_that_is_met_first_scales_the_tones_to_a_margin_below_it(which, limits):
    source = Multisine(rest_s=REST_S, ramp_s=0.0, tones=5, **limits)
    ways, speeds, changes = [], [], []
    for rate, cosines, sines in found(source):
        c, s = np.cos(rate * T_S), np.sin(rate * T_S)
        ways.append(s @ (cosines / rate) + (1.0 - c) @ (sines / rate))
        speeds.append(c @ cosines + s @ sines)
        changes.append(c @ (rate * sines) - s @ (rate * cosines))
    used = {
        "speed": np.hypot(*speeds[:2]).max() / source.speed_m_s,
        "acceleration": np.hypot(*changes[:2]).max() / source.acceleration_m_s2,
        "room": np.abs(ways[:2]).max() / (0.5 * source.room_m),
        "yaw_rate": np.abs(speeds[2]).max() / source.yaw_rate_rad_s,
        "yaw_acceleration": np.abs(changes[2]).max() / source.yaw_acceleration_rad_s2,
    }
    assert used[which] == pytest.approx(0.97)
    assert max(used[name] for name in ("speed", "acceleration", "room")) == pytest.approx(0.97)
    assert max(used[name] for name in ("yaw_rate", "yaw_acceleration")) == pytest.approx(0.97)
    assert source.at(REST_S + 50.0).pose == pytest.approx([way[5000] for way in ways], abs=1e-9)


def test_the_drive_of_an_identification_is_the_same_in_each_version():
    """Another drive would give other figures of the same robot."""
    pose, twist, acceleration = Multisine().at(9.5)
    assert pose == pytest.approx((-0.7800815626870727, 0.10675541173902557, 0.7660863471975924))
    assert twist == pytest.approx((0.3691070847854177, -0.009637433157399213, -0.47365372721129617))
    assert acceleration == pytest.approx((0.11821969405752941, 0.17655635740092845, 0.6980259884818389))
