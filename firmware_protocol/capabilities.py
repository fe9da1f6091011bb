"""The capabilities that a robot reports (DBC HELLO_IDENTITY.capabilities, ``firmware/node.h``)."""

from enum import IntFlag


class Capability(IntFlag):
    """Bits of HELLO_IDENTITY.capabilities."""

    POWER_STAGE = 0x0001
    LOCKSTEP = 0x0002
    SPEED = 0x0004
    TORQUE = 0x0008
    FEEDFORWARD = 0x0010
    CURRENTS = 0x0020
    GYRO = 0x0040
    ACCELEROMETER = 0x0080
    POWER = 0x0100
    TEMPERATURES = 0x0200
    STORAGE = 0x0400
