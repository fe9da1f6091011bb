"""The parameters of a robot by PROTOCOL.md: reading, writing, keeping. ``parameters.toml`` has their ranges."""

import random
import struct
import tomllib
import zlib
from typing import Any

from firmware_protocol.built import HERE
from firmware_protocol.generated.messages import Operation, ParameterRequest, ParameterResponse, Result, Type

TABLE: list[dict[str, Any]] = tomllib.loads((HERE / "parameters.toml").read_text(encoding="utf-8"))["parameter"]
INDEX = {row["name"]: index for index, row in enumerate(TABLE)}


SENSIBLE: dict[str, tuple[float, ...]] = {
    "counts_per_revolution": (512, 4096, 32768),
    "tracking_bandwidth_rad_s": (60.0, 150.0, 400.0),
    "speed_kp_n_m_s_rad": (0.3, 1.1, 3.0),
    "speed_ki_n_m_rad": (0.0, 25.0, 90.0),
    "torque_limit_n_m": (1.8, 5.0, 15.99609375),
    "torque_constant_n_m_a": (0.2, 1.25),
    "motor_resistance_ohm": (0.1, 0.6, 3.0),
    "motor_inductance_h": (1e-4, 5e-4, 0.02),
    "current_limit_a": (2.0, 20.0),
    "current_bandwidth_rad_s": (200.0, 1000.0, 5000.0),
    "temperature_limit_degc": (80.0, 120.0),
    "undervoltage_v": (0.0, 18.0, 23.0),
    "overspeed_rad_s": (12.0, 40.0, 127.0),
    "encoder_fault_s": (0.02, 0.1),
    "watchdog_s": (0.02, 0.05, 0.1),
    "ramp_s": (0.001, 0.05, 0.2, 0.4),
    "feedback_period_s": (0.001, 0.003, 0.005, 0.01, 0.05),
}
"""Values of parameters with which a robot drives."""


def random_values(seed: int) -> dict[str, float]:
    """Return parameters of a robot that drives."""
    chance = random.Random(seed)
    fixed = {"wheel_radius_m": 0.075, "half_length_m": 0.3, "half_width_m": 0.25}
    return fixed | {name: chance.choice(values) for name, values in SENSIBLE.items()}


def binary32(value: float) -> float:
    """Return the value rounded to binary32."""
    rounded: float = struct.unpack("<f", struct.pack("<f", value))[0]
    return rounded


def as_bits(index: int, value: float) -> int:
    """Return a parameter's value as the wire has it."""
    is_whole = TABLE[index]["type"] == "UINT32"
    return int(value) if is_whole else int.from_bytes(struct.pack("<f", value), "little")


def ends_of(index: int) -> tuple[int, int]:
    """Return the ends of a parameter's range as the wire has them."""
    low, high = (as_bits(index, binary32(TABLE[index][end])) for end in ("minimum", "maximum"))
    return low, high


def from_bits(index: int, bits: int) -> float:
    """Return the value of bits on the wire."""
    is_whole = TABLE[index]["type"] == "UINT32"
    return float(bits) if is_whole else float(struct.unpack("<f", bits.to_bytes(4, "little"))[0])


class Parameters:
    """The values in force; ``kept`` are those that a STORE keeps across a reset, None before the first."""

    def __init__(self, built_in: dict[str, float], kept: dict[str, float] | None) -> None:
        self._built_in, self.kept = built_in, kept
        self.values = dict(kept or built_in)

    def hash(self) -> int:
        """Return the CRC-32 over the values."""
        return zlib.crc32(struct.pack(f"<{len(TABLE)}f", *(self.values[row["name"]] for row in TABLE)))

    def answer(self, asked: ParameterRequest, *, idle: bool, storage: bool) -> ParameterResponse:
        """Do what is asked, and answer. ``idle``: the robot is in IDLE; ``storage``: it can keep values."""
        index, operation = asked.parameter, Operation(asked.operation)
        row = TABLE[index] if index < len(TABLE) else None
        kind = Type.FLOAT32 if row is None else Type[row["type"]]
        if operation in (Operation.STORE, Operation.RESTORE):
            result, value = self._all(operation, idle, storage), self.hash()
        elif row is None:
            result, value = Result.PARAMETER, 0
        else:
            result = self._write(index, asked.value, idle) if operation is Operation.WRITE else Result.OK
            ends = {Operation.READ_MINIMUM: row["minimum"], Operation.READ_MAXIMUM: row["maximum"]}
            value = as_bits(index, ends.get(operation, self.values[row["name"]]))
        return ParameterResponse(index, operation, asked.transaction, result, kind, value)

    def _write(self, index: int, bits: int, idle: bool) -> Result:
        row, value = TABLE[index], from_bits(index, bits)
        if not idle:
            return Result.STATE
        if not binary32(row["minimum"]) <= value <= binary32(row["maximum"]):
            return Result.RANGE
        self.values[row["name"]] = value
        return Result.OK

    def _all(self, operation: Operation, idle: bool, storage: bool) -> Result:
        if not idle:
            return Result.STATE
        if operation is Operation.RESTORE:
            self.values = dict(self._built_in)
        elif not storage:
            return Result.STORAGE
        else:
            self.kept = dict(self.values)
        return Result.OK
