"""Trouble for a robot while a host talks to it: often just below or just above a fault's threshold."""

import math
import random

from firmware_protocol.generated.messages import State
from tests.suite.robot_bench import Bench

UNMEASURED = tuple(
    (name, place, value)
    for name, places in {"current_a": 4, "gyro_rad_s": 3, "acceleration_m_s2": 3, "temperature_degc": 4}.items()
    for place in range(places)
    for value in (math.nan, 1.1e6, -1.1e6)
) + tuple((name, 0, value) for name in ("battery_v", "battery_a") for value in (math.nan, 1.1e6, -math.inf))
"""What a sensor may say that has lost its wire."""

BEYOND = (
    *(("gyro_rad_s", place, value) for place in range(3) for value in (40.0, -40.0)),
    *(("acceleration_m_s2", place, value) for place in range(3) for value in (150.0, -150.0)),
    *(("current_a", place, value) for place in range(4) for value in (33.0, -33.0)),
    *(("battery_v", 0, 300.0), ("battery_a", 0, 300.0), ("battery_a", 0, -300.0)),
    *(("temperature_degc", place, 300.0) for place in range(4)),
)
"""What a sensor can measure, and the wire cannot carry."""


class Trouble:
    """Disturbs the plant of a bench; ``until`` is the tick at which it should end."""

    def __init__(self, bench: Bench, chance: random.Random) -> None:
        self._bench, self._random = bench, chance
        self.until = 0.0

    def end(self) -> None:
        """Let the plant be as at first; a robot in FAULT is held until it rests."""
        plant, self.until = self._bench.plant, math.inf
        plant.load_n_m, plant.held = [0.0] * 4, [False] * 4
        for wheel in range(4):
            plant.reverse(wheel, 1)
        plant.temperature_degc, plant.offset_a = [25.0] * 4, [0.0] * 4
        plant.battery_v, plant.sag_ohm, plant.override = 24.0, 0.01, None
        if self._bench.robot.state is State.FAULT:
            plant.speed_rad_s = [0.0] * 4

    def begin(self) -> None:
        """Let something happen to the robot for a while: often just below or above what is a fault."""
        plant, p, chance = self._bench.plant, self._bench.robot.values, self._random
        wheel, sign = chance.randrange(4), chance.choice((-1, 1))
        self.until = self._bench.robot.tick + chance.choice((3, 5, 19, 21, 60, 60, 300, 1500))
        limit_degc = p["temperature_limit_degc"]
        match chance.randrange(11):
            case 0:
                plant.load_n_m = [sign * chance.choice((0.3, 1.5)) * p["torque_limit_n_m"]] * 4
            case 1:
                plant.held = [True] * 4
            case 2:
                plant.held[wheel] = True
            case 3:
                plant.stop(wheel)
            case 4:
                plant.reverse(wheel)
            case 5 | 6:
                heat = limit_degc - chance.choice((15.1, 14.0, 10.0, 7.5, 1.0, 0.1, 0.0))
                plant.temperature_degc[wheel] = heat
                plant.temperature_degc[(wheel + 1) % 4] = heat - 3.0
            case 7:
                plant.offset_a[wheel] = sign * chance.choice((0.9, 1.4, 1.6)) * p["current_limit_a"]
            case 8:
                plant.battery_v = p["undervoltage_v"] + chance.choice((-0.5, 0.5, -20.0))
            case 9:
                fault = p["overspeed_rad_s"]
                plant.speed_rad_s[wheel] = sign * chance.choice((0.98 * fault, 1.05 * fault, 150.0))
            case _:
                plant.override = chance.choice(chance.choice((UNMEASURED, BEYOND)))
