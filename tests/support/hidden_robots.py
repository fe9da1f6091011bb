"""Robots unknown to hil identify: a scenario with the believed values, and another plant behind the wire."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil.core.options import format_value


class Hidden(NamedTuple):
    """The true values of a robot, by name, and those that are believed."""

    true: dict[str, float]
    believed: dict[str, float]
    gyro_bias_rad_s: float


def hidden_robot(seed: int) -> Hidden:
    """Return a random robot: none of its values is a default, and what is believed of it is off by 2 to 30 %."""
    random = np.random.default_rng(seed)

    def between(low: float, high: float) -> float:
        return float(random.uniform(low, high))

    mass, radius, length, width = between(10, 40), between(0.05, 0.1), between(0.15, 0.35), between(0.15, 0.35)
    true = {
        "mass_kg": mass,
        "inertia_kg_m2": mass * (length**2 + width**2) * between(0.3, 0.8),
        "wheel_radius_m": radius,
        "half_length_m": length,
        "half_width_m": width,
        "wheel_inertia_kg_m2": mass * radius**2 * between(0.03, 0.12),
        "com_x_m": between(-0.03, 0.03),
        "com_y_m": between(-0.02, 0.02),
        "friction_coefficient": between(0.01, 0.05),
        "viscous_n_m_s_rad": between(0.005, 0.05),
        "motor_constant_n_m_a": between(0.6, 2.0),
        "grip_coefficient": between(0.5, 0.9),
    }
    spread = {"mass_kg": 0.15, "inertia_kg_m2": 0.3, "wheel_radius_m": 0.02, "half_length_m": 0.02,
              "half_width_m": 0.02, "wheel_inertia_kg_m2": 0.3, "motor_constant_n_m_a": 0.1}  # fmt: skip
    believed = {name: float(true[name] * np.exp(random.normal(0.0, sigma))) for name, sigma in spread.items()}
    bias_rad_s = float(random.normal(0.0, 0.01))
    true["roller_friction_coefficient"] = between(0.005, 0.02)
    return Hidden(true, believed, bias_rad_s)


def scenario_text(robot: Hidden, plant: dict[str, object], seed: int) -> str:
    """Return a scenario of the robot with sensors' noise; ``plant`` has more of [plant.start], such as the contact."""
    constant = robot.believed["motor_constant_n_m_a"]
    believed = {name: value for name, value in robot.believed.items() if name != "motor_constant_n_m_a"}
    # Enough to slide on any of these floors.
    torque_n_m = min(15.0, robot.believed["mass_kg"] * 9.81 / 4.0 * robot.believed["wheel_radius_m"])
    start = {
        **robot.true,
        "drive": "current",
        "current_limit_a": 100.0,
        "battery_voltage_v": 100.0,
        "gyro_noise_rad_s": 0.01,
        "gyro_bias_z_rad_s": robot.gyro_bias_rad_s,
        "seed": seed,
        **plant,
    }
    tables = {
        "robot": {
            **believed,
            "friction_coefficient": 0.02,
            "torque_limit_n_m": torque_n_m,
            "speed_limit_rad_s": 30.0,
        },
        "plant.start": start,
        "firmware": {"torque_limit_n_m": torque_n_m, "torque_constant_n_m_a": constant},
        "link": {"command_latency_s": 0.0, "feedback_latency_s": 0.0},
        "loop": {"rate_hz": 200, "seed": seed},
    }
    lines = ['extends = "circle_speed"']
    for name, values in tables.items():
        lines += ["", f"[{name}]", *(f"{key} = {format_value(value)}" for key, value in values.items())]
    return "\n".join([*lines, ""])


def write_scenario(folder: Path, robot: Hidden, plant: dict[str, object], seed: int) -> Path:
    """Write the scenario into a folder and return its path."""
    path = folder / "my_robot.toml"
    path.write_text(scenario_text(robot, plant, seed), encoding="utf-8")
    return path
