"""Values that no run can hold: times after its end, and numbers in another unit."""

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Annotated

import pytest
from hypothesis import given
from hypothesis import strategies as st

import hil
from hil.core.errors import BadInputError
from hil.core.options import OptionsError, Range, build
from hil.scenario import load
from hil.scenario.trial import ExpectTable, FaultTable
from hil.scenario.unreached import beyond_the_end, without_effect
from tests.support.processes import hil as command

BASE = load("circle_speed")
MILLISECONDS = st.integers(0, 3000).map(lambda ms: ms / 1000.0)


@given(
    MILLISECONDS, MILLISECONDS.filter(bool), MILLISECONDS.filter(bool), st.sampled_from([20, 40, 50, 125, 200, 1000])
)
def test_a_claim_is_told_as_late_when_no_tick_is_within_it(
    from_s: float, span_s: float, end_s: float, rate: int
) -> None:
    row = ExpectTable(signal="error.planar_m", below=1.0, from_s=from_s, to_s=from_s + span_s)
    fault = FaultTable("drop", "command", start_s=from_s, value=0.1)
    tables = replace(BASE, loop=replace(BASE.loop, duration_s=end_s, rate_hz=rate), expect=(row,), fault=(fault,))
    low, high, end = (Fraction(round(1000 * value), 1000) for value in (from_s, from_s + span_s, end_s))
    ticks = [Fraction(k, rate) for k in range(math.ceil(end * rate))]
    told = {key.partition(".")[0] for key, _ in beyond_the_end(tables)}
    assert ("expect" in told) == (not any(low <= tick <= high for tick in ticks))
    assert ("fault" in told) == (not any(low <= tick for tick in ticks))


@pytest.mark.parametrize("from_s", [0.05, 0.095, 0.0951, 0.1, 3.0])
def test_it_is_told_exactly_when_the_run_has_no_samples_there(from_s: float) -> None:
    claim = {"signal": "error.planar_m", "below": 9.0, "from_s": from_s}
    given = {"loop.duration_s": 0.1, "expect": [claim]}
    [row] = hil.run("circle_speed", set=given).metrics["expect"]
    late = list(beyond_the_end(load("circle_speed", set=given)))
    assert ("no samples" in row["text"]) == bool(late)


LATE = {
    "[[expect]]\nsignal = 'error.planar_m'\nbelow = 1\nfrom_s = 25": "expect.1.from_s: it is judged from 25 s on",
    "[[expect]]\nat_rest = true\nfrom_s = 20": "expect.1.from_s",
    "[[expect]]\nstops = 'OVERSPEED'\nfrom_s = 21": "expect.1.from_s",
    "[[fault]]\nkind = 'estop'\nstart_s = 20": (
        "fault.1.start_s: the run ends at loop.duration_s = 20, so that it would never act; expected an earlier time"
    ),
    "[[fault]]\nkind = 'drop'\ntarget = 'command'\nvalue = 0.1\nstart_s = 19\n"
    "[[expect]]\nat_rest = true\nafter_fault = 'drop'\nwithin_s = 2": "expect.1.within_s: it is judged from 21 s on",
    "[[expect]]\nsignal = 'error.planar_m'\nbelow = 1\nfrom_s = 1.001\nto_s = 1.004": (
        "expect.1.to_s: no tick of 200 Hz is from 1.001 s to 1.004 s"
    ),
    "[estimator]\nsource = 'fused'\nsimulated_fix.gap_start_s = 20\nsimulated_fix.gap_end_s = 40": (
        "gap_start_s: the run ends at loop.duration_s = 20, before this gap; expected an earlier time"
    ),
    "[reference]\nkind = 'multisine'\nrest_s = 20": (
        "reference.rest_s: the run ends at loop.duration_s = 20, so that the robot would never move; expected less"
    ),
}


@pytest.mark.parametrize("text", LATE)
def test_a_time_after_the_end_is_no_good_scenario(tmp_path: Path, text: str) -> None:
    path = tmp_path / "my.toml"
    path.write_text(f"extends = 'circle_speed'\nloop.duration_s = 20\n{text}\n")
    done = command("check", path)
    assert done.returncode == 1
    [told] = [line for line in done.stdout.splitlines() if "after the end" in line]
    assert "my.toml:" in told
    assert LATE[text] in told


WRONG_UNITS = {
    "robot.wheel_radius_m=76": "76 m? if you mean millimetres, write 0.076",
    "robot.mass_kg=24000": "24000 kg? if you mean grams, write 24",
    "robot.speed_limit_rad_s=300": "300 rad/s? if you mean turns a minute, write 31.416",
    "robot.torque_limit_n_m=1500": "1500 N·m? if you mean N·mm, write 1.5",
    "firmware.watchdog_s=50": "50 s? if you mean milliseconds, write 0.05",
    "reference.heading_rad=90": "90 rad? if you mean degrees, write 1.5708",
    "plant.start.start_heading_rad=-90": "-90 rad? if you mean degrees, write -1.5708",
    "plant.start.wheel_radius_m=76": "76 m? if you mean millimetres, write 0.076",
    "fault=[{kind='delay', target='command', value=25}]": "25 s? if you mean milliseconds, write 0.025",
    "expect=[{signal='error.heading_rad', below=5}]": "5 rad? if you mean degrees, write 0.087266",
    "expect=[{signal='error.heading_rad', within=[-5, 5]}]": "-5 rad? if you mean degrees, write -0.087266",
}


@pytest.mark.parametrize("text", WRONG_UNITS)
def test_a_number_in_another_unit_is_refused_with_the_right_one(text: str) -> None:
    with pytest.raises(BadInputError) as refused:
        load("paper_circle", set=[text])
    assert WRONG_UNITS[text] in str(refused.value)


def test_a_turn_may_be_rounded_up() -> None:
    load(
        "paper_circle",
        set=["reference.heading_rad=6.284", "expect=[{signal='error.heading_rad', within=[-3.142, 3.142]}]"],
    )


def test_an_angle_of_somebody_elses_options_may_be_of_many_turns() -> None:
    @dataclass
    class Own:
        lead_rad: float = 0.0
        size_m: Annotated[float, Range(gt=0, le=2)] = 1.0

    assert build(Own, {"lead_rad": 100.0}).lead_rad == 100.0
    with pytest.raises(OptionsError, match=r"if you mean millimetres, write 0\.3"):
        build(Own, {"size_m": 300.0})


WITHOUT_EFFECT = {
    "estimator.filter.start_sigma_m=0.5": {"estimator.source": "fused"},
    "estimator.simulated_fix.sigma_m=0.5": {"estimator.source": "fused"},
    "estimator.slip_threshold_m_s=1e-4": {"estimator.source": "fused", "plant.start.gyro_noise_rad_s": 0.5},
    "limiter.slip_m_s=1e-4": {
        "controller.command": "torque",
        "plant.start.contact": "slip",
        "plant.start.grip_coefficient": 0.1,
    },
    "plant.start.grip_coefficient=0.01": {"plant.start.contact": "slip"},
    "plant.start.wheel.fl.grip_factor=0.01": {"plant.start.contact": "slip"},
    "plant.start.roller_friction_coefficient=0.5": {"plant.start.contact": "slip"},
    "plant.start.current_limit_a=0.01": {"plant.start.drive": "current"},
    "plant.start.motor_inductance_h=0.1": {"plant.start.drive": "voltage"},
    "plant.start.slope_direction_rad=1.0": {"plant.start.slope_rad": 0.2},
    "plant.start.seed=7": {"plant.start.gyro_noise_rad_s": 0.1},
    "realtime.priority=1": None,
    "device.guardian_s=0.5": None,
    "plant.timeout_s=1.0": None,
}
"""What nothing reads in circle_speed, and what makes it count in a short run."""


@pytest.mark.parametrize("text", WITHOUT_EFFECT)
def test_a_value_that_is_told_as_without_effect_has_none_and_others_have(text: str) -> None:
    def signals(*sets: str) -> list[bytes]:
        run = hil.run("circle_speed", set=["loop.duration_s=0.2", "plant.start.start_y_m=0.1", *sets], lenient=True)
        return [run.signals[name].tobytes() for name in run.signals if name.startswith(("pose.", "robot.", "wheel."))]

    key, counts = text.partition("=")[0], WITHOUT_EFFECT[text]
    assert [told for told, _ in without_effect(load("circle_speed", set=[text]))] == [key]
    assert signals(text) == signals()
    if counts is not None:
        more = [f"{name}={value}" for name, value in counts.items()]
        assert not [told for told, _ in without_effect(load("circle_speed", set=[text, *more])) if told == key]
        assert signals(text, *more) != signals(*more)


@pytest.mark.parametrize(
    ("sets", "told"),
    [
        (
            ["commission.lateral_scale=0.9"],
            "it was measured, and nothing uses it yet: odometry and laws believe the wheels",
        ),
        (["estimator.slip_threshold_m_s=1e-4"], "the true pose is not estimated"),
        (["estimator.simulated_fix.sigma_m=0.5"], "only simulated fixes of a fused estimator read it"),
        (["estimator.filter.begin='fix'"], 'estimator.source = "fused" alone reads it'),
        (["device.guardian_s=0.5"], "our firmware has a watchdog of its own, and no guardian"),
        (["realtime.priority=1"], 'loop.mode = "realtime" alone reads it'),
        (["limiter.slip_m_s=1"], 'controller.command = "torque" alone is limited so'),
        (["plant.memory_limit_mb=500"], "a shipped FMU runs in the robot's own process"),
        (["plant.start.grip_coefficient=0.1"], 'wheels slip only with plant.start.contact = "slip"'),
        (["plant.start.current_limit_a=9"], 'plant.start.drive = "torque" takes torques as they are'),
        (["plant.start.slope_direction_rad=1"], "the ground is level: plant.start.slope_rad is 0"),
        (["plant.start.imu_rate_hz=100"], "it is of the sensors' noise, which is 0"),
    ],
)
def test_why_a_value_has_no_effect_is_told(sets: list[str], told: str) -> None:
    reasons = dict(without_effect(load("circle_speed", set=sets)))
    assert reasons[sets[0].partition("=")[0]].endswith(told)


SIZES = [
    "reference.radius_m",
    "reference.period_s",
    "plant.start.start_x_m",
    "robot.mass_kg",
    "controller.gains.k1_1_s",
    "estimator.filter.start_sigma_m",
    "expect=[{ signal = 'pose.x_m', below = V }]",
    "fault=[{ kind = 'override', target = 'error.planar_m', value = V }]",
    "loop.duration_s",
]


@pytest.mark.parametrize("where", SIZES)
@pytest.mark.parametrize("value", ["1e308", "1.1e30", "-1e308", "1e-308", "0.9e-30"])
def test_a_size_that_overflows_when_squared_is_refused(where: str, value: str) -> None:
    text = where.replace("V", value) if "V" in where else f"{where}={value}"
    with pytest.raises(BadInputError, match="expected"):
        load("circle_speed", set=[text])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "text", ["reference.radius_m=1e30", "reference.period_s=1e-30", "plant.start.start_x_m=-1e30", "reference.blend_m"]
)
def test_the_largest_and_smallest_sizes_are_calculated_with(text: str) -> None:
    name, text = ("waypoints", f"{text}=1e-30") if "blend" in text else ("circle_speed", text)
    set_ = [text, "loop.duration_s=5.5", "loop.rate_hz=50", "expect=[]"]
    list(hil.run(name, set=set_, lenient=True).lines())
