"""Tells which values of a scenario an encoder is too coarse for. No side effects."""

import math
from collections.abc import Iterator

from hil.core.motion_limits import slip_band
from hil.core.wheel_speed import WheelSpeed, slower
from hil.scenario.tables import Tables

_MOST_TORQUE = 0.6
"""Share of the torque limit that the speed loop may make of what an encoder adds to a speed."""
_MOST_SPEED = 0.05
"""Share of the speed limit that a law may see of it."""


def coarse(tables: Tables) -> Iterator[str]:
    """Yield a sentence for each part of a run that cannot do what it is set to, with what to set; none by default."""
    if tables.device.is_makers:
        return  # of their filters and gains nothing is known
    robot, firmware, estimator = tables.robot, tables.firmware, tables.estimator
    counts, bandwidth_rad_s = firmware.counts_per_revolution, firmware.tracking_bandwidth_rad_s
    speed = WheelSpeed(counts, bandwidth_rad_s)
    noise_rad_s, radius_m = speed.noise_rad_s, robot.wheel_radius_m
    moves = f"with {counts} counts a turn the measured speed of a wheel that rolls evenly moves by up to"
    if tables.controller.command == "speed":
        torque_n_m, limit_n_m = firmware.speed_kp_n_m_s_rad * noise_rad_s, firmware.torque_limit_n_m
        if torque_n_m > _MOST_TORQUE * limit_n_m:
            factor = min(slower(counts), math.sqrt(_MOST_TORQUE * limit_n_m / torque_n_m))
            yield (
                f"{moves} {noise_rad_s:.2g} rad/s, and speed_kp_n_m_s_rad makes {torque_n_m:.2g} N·m of it, where the "
                f"limit is {limit_n_m:g} N·m; set firmware.tracking_bandwidth_rad_s={bandwidth_rad_s * factor:.3g}, "
                f"firmware.speed_kp_n_m_s_rad={firmware.speed_kp_n_m_s_rad * factor:.3g} and "
                f"firmware.speed_ki_n_m_rad={firmware.speed_ki_n_m_rad * factor**2:.3g}"
            )
        return
    noise_m_s, slip_m_s = radius_m * noise_rad_s, tables.limiter.most_slip_m_s(estimator.source)
    latency_s = tables.link.command_latency_s + tables.link.feedback_latency_s
    band = slip_band(slip_m_s, radius_m, speed, tables.loop.period_ns * 1e-9, latency_s)
    lacks = max(2.0 * band.begin_m_s, (band.begin_m_s + band.blind_m_s) / 1.5) / slip_m_s
    if math.isfinite(slip_m_s) and lacks > 1.0 + 1e-9:
        yield (
            f"{moves} {noise_m_s:.2g} m/s at the rim, and of a change to come {band.blind_m_s:.2g} m/s is not seen: "
            f"wheels that slip lose their torque at {band.begin_m_s:.2g} m/s to {band.end_m_s:.2g} m/s, but later than "
            f"limiter.slip_m_s = {slip_m_s:g} asks for; that needs {math.ceil(counts * lacks)} counts, or a limit of "
            f"{slip_m_s * lacks:.2g} m/s"
        )
    is_felt = estimator.source != "truth" or estimator.twist == "wheels"
    if is_felt and noise_rad_s > _MOST_SPEED * robot.speed_limit_rad_s:
        yield (
            f"{moves} {noise_m_s:.2g} m/s at the rim, and a law that commands torques acts on it: set "
            f'controller.command="speed", or expect torques that vary'
        )
