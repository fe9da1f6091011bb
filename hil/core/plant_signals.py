"""The signals between the bridge and a plant, by the names that ``[plant.map]`` uses. The unit ends the name.

Outputs and inputs are in the order of the enumerations in ``cosim.h``.
"""

from hil.core.types import WHEEL_NAMES, Pose, Twist

TORQUES = tuple(f"wheel.{wheel}.torque_n_m" for wheel in WHEEL_NAMES)
DUTIES = tuple(f"wheel.{wheel}.duty" for wheel in WHEEL_NAMES)
ENABLED = ("drive.enabled",)
POSE = tuple(f"pose.{name}" for name in Pose._fields)
TWIST = tuple(f"twist.{name}" for name in Twist._fields)
SPEEDS = tuple(f"wheel.{wheel}.speed_rad_s" for wheel in WHEEL_NAMES)
CURRENTS = tuple(f"wheel.{wheel}.current_a" for wheel in WHEEL_NAMES)
GYRO = tuple(f"gyro.{axis}_rad_s" for axis in "xyz")
ACCELEROMETER = tuple(f"accelerometer.{axis}_m_s2" for axis in "xyz")
BATTERY = ("battery.voltage_v", "battery.current_a")
TEMPERATURES = tuple(f"wheel.{wheel}.temperature_degc" for wheel in WHEEL_NAMES)
COUNTS = tuple(f"wheel.{wheel}.count" for wheel in WHEEL_NAMES)
ANGLES = tuple(f"wheel.{wheel}.angle_rad" for wheel in WHEEL_NAMES)

# Sensors that an FMU need not have.
SENSORS = {"accelerometer": ACCELEROMETER, "battery": BATTERY, "temperatures": TEMPERATURES}

INPUTS = (*TORQUES, *DUTIES, *ENABLED)
OUTPUTS = (*(*POSE, *TWIST, *SPEEDS, *CURRENTS, *GYRO, *ACCELEROMETER), *(*BATTERY, *TEMPERATURES, *COUNTS, *ANGLES))

DERIVABLE = (*TWIST, *SPEEDS, *CURRENTS, *GYRO, *COUNTS, *ACCELEROMETER, *BATTERY, *TEMPERATURES)
"""Outputs that may be missing: they are derived from others, or the robot has no such sensor."""
