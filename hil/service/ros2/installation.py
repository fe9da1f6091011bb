"""Finds ROS 2: a sourced installation, or the wheels of the extra ``ros2`` with the messages that have none."""

import importlib
import importlib.util
import os
import sys

from platformdirs import user_cache_path

from hil.core.errors import BadInputError

_TOO_OLD = ("foxy", "galactic", "humble", "iron")  # made for Python 3.8 or 3.10
_WHEELS = "pip install 'mecanum-hil[ros2]' on Linux"


def require_ros() -> None:
    """Make ``rclpy`` and all messages importable.

    Raises BadInputError when ROS 2 is missing, too old, or made for another Python.
    """
    distribution = os.environ.get("ROS_DISTRO", "")
    if distribution in _TOO_OLD:
        raise BadInputError(
            f"ROS 2 {distribution.capitalize()} is sourced, which is made for an older Python than hil needs (3.11); "
            f"source Jazzy or later, or in a terminal without it: {_WHEELS}"
        )
    try:
        importlib.import_module("rclpy")
    except ImportError as error:
        raise BadInputError(
            f"ROS 2 is not there for this Python {sys.version_info[0]}.{sys.version_info[1]} ({error}); {_WHEELS}, or "
            "source ROS 2's setup.bash and use the Python that it was made for"
        ) from error
    missing = [name for name in ("tf2_msgs", "simulation_interfaces") if importlib.util.find_spec(name) is None]
    if missing and distribution:
        packages = " ".join(f"ros-{distribution}-{name.replace('_', '-')}" for name in missing)
        raise BadInputError(f"ROS 2 {distribution.capitalize()} lacks {' and '.join(missing)}; apt install {packages}")
    if missing:
        from hil.service.ros2.generate import provide

        sys.path.append(str(provide(user_cache_path("mecanum-hil", appauthor=False) / "ros2")))


if __name__ == "__main__":  # of make: what has to be compiled is compiled before the tests
    if sys.platform == "linux" and importlib.util.find_spec("rclpy") is not None:
        require_ros()
