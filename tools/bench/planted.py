"""The defects that ``tools.bench.hunt`` plants, and the scenario and the space of the search.

All share one scenario, a robot that drives by odometry onto a circle for 0.8 s, its expectations, and ranges of start
states, plant parameters, latency and faults. The expectations hold there without a defect. There are three kinds of
defects: keys of the scenario (their margin shrinks before they break anything), a condition on the law's inputs, and a
condition on values and faults of the run that are no input of the law. Of those with a condition nothing shows before
it is met, other than that expectations are nearer to breaking there, or not.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hil.addons.batch.hunt.hunt import Hunt
from hil.addons.batch.hunt.hunt_file import Request
from tools.bench.planted_law import CONDITIONS, WATCH

SCENARIO = """
extends = "circle_speed"

[estimator]
source = "odometry"

[controller]
law = "tools.bench.planted_law:Planted"
command = "speed"

[controller.gains]
k1_1_s = 8.0

[loop]
duration_s = 0.8

[plant.start]
start_x_m = 1.0
start_y_m = 0.0
start_heading_rad = 0.785
mass_kg = 20.0

[[expect]]
signal = "error.planar_m"
below = 0.34

[[expect]]
signal = "error.planar_m"
from_s = 0.6
below = 0.32

[[expect]]
signal = "error.heading_rad"
within = [-0.3, 0.3]

[[expect]]
signal = "error.heading_rad"
from_s = 0.6
within = [-0.25, 0.25]

[[expect]]
signal = "pose.x_m"
of = "truth.x_m"
within = [-0.13, 0.13]

[[expect]]
signal = "pose.y_m"
of = "truth.y_m"
within = [-0.13, 0.13]

[[expect]]
signal = "pose.heading_rad"
of = "truth.heading_rad"
within = [-0.25, 0.25]

[[expect]]
signal = "wheel.fr.speed_rad_s"
within = [-22.5, 22.5]

[[expect]]
signal = "wheel.fl.speed_rad_s"
within = [-19.5, 19.5]

[[expect]]
signal = "twist.yaw_rate_rad_s"
within = [-2.0, 2.0]

[[expect]]
figure = "effort_n_m_s"
below = 4.6
"""
HUNT = """
runs = {runs}
seed = {seed}
at_once = 2

[set]
{sets}

[range]
plant.start.mass_kg = [17, 23]
plant.start.friction_coefficient = {{ log_uniform = [0.02, 0.1] }}
plant.start.wheel_radius_m = [0.074, 0.076]
plant.start.start_x_m = [0.9, 1.1]
plant.start.start_y_m = [-0.1, 0.1]
plant.start.start_heading_rad = [0.585, 0.985]
reference.period_s = [9, 20]
link.command_latency_s = {{ uniform = [0.0, 0.01], step = 0.001 }}

[[fault]]
kind = "drop"
target = ["command", "feedback"]
start_s = [0.0, 0.7]
duration_s = [0.02, 0.08]
value = [0.1, 0.9]

[[fault]]
kind = "push"
target = ["force_x_n", "force_y_n"]
start_s = [0.0, 0.7]
duration_s = [0.05, 0.2]
value = [-30, 30]

[[fault]]
kind = "push"
target = "moment_n_m"
start_s = [0.0, 0.7]
duration_s = [0.05, 0.2]
value = [-4, 4]

[[fault]]
kind = "dead_motor"
target = ["fl", "rr"]
start_s = [0.0, 0.7]
duration_s = [0.02, 0.06]

[[fault]]
kind = "gyro_bias"
start_s = [0.0, 0.7]
duration_s = [0.05, 0.3]
value = [-0.3, 0.3]
"""


class Drawn:
    """The values and faults of a run, from the scenario of its job."""

    def __init__(self, scenario: Mapping[str, Any]) -> None:
        self._tables = scenario["tables"]
        self.period_s: float = self._tables["reference"]["period_s"]
        self.latency_s: float = self._tables["link"]["command_latency_s"]

    def start(self, name: str) -> float:
        """A value of ``[plant.start]``."""
        return float(self._tables["plant"]["start"][name])

    def faults(self, kind: str, *targets: str) -> Sequence[Mapping[str, Any]]:
        """The faults of a kind, and of these targets if there are any."""
        rows = self._tables["fault"]
        return [row for row in rows if row["kind"] == kind and (not targets or row["target"] in targets)]


class Defect(NamedTuple):
    """A planted defect.

    Attributes:
        name: also the condition of ``planted_law.CONDITIONS``, if it has one there. where: the room it would be in.
        words: a text on the defect. then: the law's action once the condition is met. when: a condition on the run.
        keys: the keys of the scenario that plant it; such a defect has no condition.
    """

    name: str
    where: str
    words: str
    then: str = "away"
    when: Callable[[Drawn], bool] | None = None
    keys: Mapping[str, Any] = {}

    @property
    def has_condition(self) -> bool:
        """Whether nothing shows before a condition is met."""
        return not self.keys

    @property
    def is_seen(self) -> bool:
        """Whether its condition is one on what the law sees."""
        return self.has_condition and self.when is None

    @property
    def sets(self) -> Mapping[str, Any]:
        """The keys of the scenario that plant it."""
        condition = self.name if self.name in CONDITIONS else "from the start"
        return self.keys or {"controller.gains.defect": condition, "controller.gains.then": self.then}

    def is_met(self, scenario: Mapping[str, Any], met: int) -> bool:
        """Return whether a run without defects met its condition; ``met`` is what the law's signal said at the end."""
        if self.when is not None:
            return self.when(Drawn(scenario))
        return bool(met >> list(CONDITIONS).index(self.name) & 1)


def _overlaps(one: Mapping[str, Any], other: Mapping[str, Any], within_s: float) -> bool:
    return bool(abs(one["start_s"] - other["start_s"]) < within_s)


DEFECTS = (
    Defect("turned far", "law", "wrong sign beyond 0.2 rad of heading error"),
    Defect("left behind", "law", "gives up when more than 0.21 m behind", "rest"),
    Defect("off and turned", "law", "wrong branch when off by 0.18 m and turned by 0.12 rad"),
    Defect("corner", "law", "wrong sign in one corner of x, y and heading error"),
    Defect("slow and spinning", "law", "division by the speed of a slow reference, in a fast turn", "hold"),
    Defect("windup", "law", "the integral of the heading's error overflows", "spin"),
    Defect("needle", "law", "one wrong entry of a table over x, y and heading error"),
    Defect("cell", "law", "one wrong entry of a table over heading error and speed"),
    Defect("silent at speed", "estimator", "loses its pose after 14 ticks without feedback above 0.8 m/s", "spin"),
    Defect("gyro jump", "estimator", "takes a jump of the yaw rate for a broken gyro and freezes", "hold"),
    Defect("spin at speed", "estimator", "wrong sign when fast and spinning at once"),
    Defect("overspeed", "firmware", "a set point wraps above 1.15 m/s", "spin"),
    Defect("crossed wheels", "firmware", "FR turns the wrong way after FL and RR were sent fast against each other",
           "reversed"),
    Defect("set point drop", "firmware", "a set point wraps when it falls by 8 rad/s in a tick", "spin"),
    Defect("heavy, sticky and late", "plant", "drives cut out: heavy, much friction, long latency", "rest",
           lambda d: d.start("mass_kg") > 22.0 and d.start("friction_coefficient") > 0.085 and d.latency_s > 0.008),
    Defect("light, smooth and large", "plant", "wheels lose contact: light, little friction, large wheels", "hold",
           lambda d: d.start("mass_kg") < 17.9 and d.start("friction_coefficient") < 0.0225
           and d.start("wheel_radius_m") > 0.0758),
    Defect("fast, heavy and behind", "plant", "drives cut out: fast circle, heavy, behind at the start", "rest",
           lambda d: d.period_s < 10.2 and d.start("mass_kg") > 22.2 and d.start("start_y_m") < -0.08),
    Defect("slow, small and ahead", "plant", "a wheel slips: slow circle, small wheels, ahead at the start", "spin",
           lambda d: d.period_s > 18.5 and d.start("wheel_radius_m") < 0.0742 and d.start("start_y_m") > 0.08),
    Defect("drop as a push begins", "wire", "loses its session when commands are lost as a push begins", "rest",
           lambda d: any(_overlaps(a, b, 0.02) for a in d.faults("drop", "command")
                         for b in d.faults("push", "force_x_n", "force_y_n"))),
    Defect("dead motor with gyro bias", "wire", "recovers with the wrong sign: motor dead, then a biased gyro", "away",
           lambda d: any(0.0 < b["start_s"] - a["start_s"] < 0.1 and abs(b["value"]) > 0.15
                         for a in d.faults("dead_motor", "fl") for b in d.faults("gyro_bias"))),
    Defect("feedback lost at 0.3 s", "wire", "a count wraps at 0.3 s, and feedback is lost just then", "hold",
           lambda d: any(abs(a["start_s"] - 0.3) < 0.008 and a["value"] > 0.6 for a in d.faults("drop", "feedback"))),
    Defect("long drop and late", "wire", "the watchdog does not re-arm: long loss of commands, long latency", "rest",
           lambda d: d.latency_s > 0.008 and any(a["end_s"] - a["start_s"] > 0.07 and a["value"] > 0.75
                                                 for a in d.faults("drop", "command"))),
    Defect("weak motors", "firmware", "a limit of the torque that is too low",
           keys={"firmware.torque_limit_n_m": 1.0}),
    Defect("short watchdog", "firmware", "a watchdog shorter than a loss of commands",
           keys={"firmware.watchdog_s": 0.06}),
    Defect("large wheels believed", "estimator", "wheels that are believed to be too large",
           keys={"robot.wheel_radius_m": 0.096}),
    Defect("clipped wheels", "law", "a limit of each wheel by itself, which turns the robot",
           keys={"controller.gains.limit": 11.0}),
    Defect("slow wheels", "law", "a limit of each wheel's acceleration by itself",
           keys={"controller.gains.rate": 38.0}),
)  # fmt: skip
"""They were chosen before a hunt looked for them, and their levels set by the share of random runs that meet them.

Those of weak motors, large wheels and slow wheels were set anew, by that share, after a first hunt.
"""


def hunt_of(sets: Mapping[str, Any], folder: Path, runs: int, seed: int) -> Hunt:
    """Return a hunt in the planted scenario with these keys; a folder takes its files."""
    (folder / "planted.toml").write_text(SCENARIO, encoding="utf-8")
    words = "\n".join(f"{key} = {json.dumps(value)}" for key, value in sets.items())
    (folder / "planted.hunt.toml").write_text(HUNT.format(runs=runs, seed=seed, sets=words), encoding="utf-8")
    return Hunt(Request(str(folder / "planted.toml")))


HEALTHY: Mapping[str, Any] = {"controller.gains.defect": WATCH}
