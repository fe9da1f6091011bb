"""Hypothesis strategies: robots that could be built, and their inputs."""

from typing import Any

from hypothesis import strategies as st

from tests.support.plant_testbed import RIGID, START, TORQUE, O, X, wheels

HOLDS = 3  # how often a run changes its inputs


def _between(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False, allow_infinity=False)


def robots(*, contact: int = RIGID, drive: int = TORQUE, **fixed: Any) -> st.SearchStrategy[dict[str, float]]:
    """Robots of 5 to 60 kg on a slope, with centre of mass, arrangement, motors and start of any kind."""
    parameters: dict[str, st.SearchStrategy[float]] = {
        "mass_kg": _between(5, 60),
        "inertia_kg_m2": _between(0.3, 5),
        "com_x_m": _between(-0.03, 0.03),
        "com_y_m": _between(-0.03, 0.03),
        "com_height_m": _between(0, 0.05),
        "wheel_radius_m": _between(0.04, 0.15),
        "half_length_m": _between(0.2, 0.5),
        "half_width_m": _between(0.2, 0.5),
        "wheel_inertia_kg_m2": _between(0.002, 0.02),
        "viscous_n_m_s_rad": _between(0, 0.05),
        "slope_rad": _between(0, 0.15),
        "slope_direction_rad": _between(-4, 4),
        "rollers": st.sampled_from([X, O]),
        "gear_ratio": _between(5, 20),
        "rotor_inertia_kg_m2": _between(0, 2e-5),
        "motor_constant_n_m_a": _between(0.05, 0.1),
        "motor_resistance_ohm": _between(0.3, 1),
        "motor_inductance_h": _between(3e-4, 2e-3),
        "battery_resistance_ohm": _between(0, 0.1),
        "battery_fall_v_c": _between(0, 5),
        "grip_coefficient": _between(0.5, 0.9),
        "roller_friction_coefficient": _between(0, 0.02),
        **dict.fromkeys(wheels("radius_factor"), _between(0.9, 1.1)),
        **dict.fromkeys(wheels("torque_factor"), _between(0.8, 1.2)),
        **dict.fromkeys(wheels("friction_factor"), _between(0.0, 3.0)),
        "sideways_loss": _between(-0.1, 0.1),
        **dict(zip(START, [*[_between(-2, 2)] * 3, *[_between(-0.5, 0.5)] * 3], strict=True)),
    }
    chosen = {name: st.just(value) for name, value in fixed.items()}
    return st.fixed_dictionaries({**parameters, **chosen, "contact": st.just(contact), "drive": st.just(drive)})


def held(largest: float, push: tuple[float, float, float] = (10, 10, 1)) -> st.SearchStrategy[list[Any]]:
    """Torques or duties up to ``largest``, and pushes (force x, y [N], moment [N m]), one after another."""
    drives = st.tuples(*[_between(-largest, largest)] * 4)
    pushes = st.tuples(*(_between(-most, most) for most in push))
    return st.lists(st.tuples(drives, pushes), min_size=HOLDS, max_size=HOLDS)
