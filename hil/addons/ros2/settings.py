"""The node's parameters (ROS2.md), declared in one place with their defaults."""

from dataclasses import dataclass, fields
from typing import Any, Self

from hil.core.errors import BadInputError

_WHEELS = ("front_left", "front_right", "rear_right", "rear_left")  # in the order of ``WHEEL_NAMES``


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Parameters of the node by their names; ROS2.md says what each means."""

    base_frame_id: str = "base_link"
    odom_frame_id: str = "odom"
    imu_frame_id: str = "imu_link"
    joint_names: tuple[str, ...] = tuple(f"{wheel}_wheel_joint" for wheel in _WHEELS)
    enable_odom_tf: bool = True
    publish_rate_hz: float = 200.0
    pose_sigma: tuple[float, ...] = (0.05, 0.05)
    twist_sigma: tuple[float, ...] = (0.02, 0.05)
    use_stamped_vel: bool = False
    command_timeout_s: float = 0.2
    command_rate_hz: float = 100.0
    real_time_factor: float = 1.0
    wait_for_wheels_s: float = 0.0

    @classmethod
    def declared(cls, node: Any) -> Self:
        """Declare the parameters at a node; return their values. Raises BadInputError for one out of its range."""
        from rcl_interfaces.msg import ParameterDescriptor

        fixed = ParameterDescriptor(read_only=True)
        values: dict[str, Any] = {}
        for one in fields(cls):
            default = one.default
            given = node.declare_parameter(one.name, list(default) if isinstance(default, tuple) else default, fixed)
            values[one.name] = tuple(given.value) if isinstance(default, tuple) else given.value
        made = cls(**values)
        made.check()
        return made

    def check(self) -> None:
        """Raise BadInputError, with the parameter's name, for a value out of its range."""
        for name, length in (("joint_names", 4), ("pose_sigma", 2), ("twist_sigma", 2)):
            if len(getattr(self, name)) != length:
                raise BadInputError(f"parameter {name}: {len(getattr(self, name))} values; expected {length}")
        if len(set(self.joint_names)) != 4:
            raise BadInputError("parameter joint_names: two wheels have the same name; expected FL, FR, RR, RL")
        for name, least, most in (
            ("publish_rate_hz", 1.0, 1000.0),
            ("command_timeout_s", 0.01, 10.0),
            ("command_rate_hz", 1.0, 150.0),
            ("real_time_factor", 0.001, 1000.0),
            ("wait_for_wheels_s", 0.0, 10.0),
        ):
            if not least <= getattr(self, name) <= most:
                raise BadInputError(f"parameter {name} = {getattr(self, name)}: expected {least:g} to {most:g}")
