"""The handshake: HELLO and its pages, and the checks of the robot before anything moves."""

import time
from collections.abc import Mapping
from typing import NamedTuple

from firmware_protocol import codec
from firmware_protocol.capabilities import Capability
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.core.errors import BadInputError, DeviceError
from hil.core.ports import Link
from hil.robot.robot_report import NO_FAULT, ProcessorFault, reset_words

SILENCE_NS = 2_000_000_000
RETRY_NS = 200_000_000
_PAGES = (
    m.HelloIdentity,
    m.HelloFirmware,
    m.HelloParameters,
    m.HelloGeometry,
    m.HelloLimits,
    m.HelloFaultStatus,
    m.HelloFaultPlace,
    m.HelloFaultAddress,
)


_TROUBLE = (m.ResetCause.BROWN_OUT, m.ResetCause.WATCHDOG, m.ResetCause.LOW_POWER, m.ResetCause.PROCESSOR_FAULT)


class RobotInfo(NamedTuple):
    """What the robot reports in HELLO."""

    capabilities: int
    firmware: str
    build: int
    parameter_hash: int
    watchdog_ms: int
    geometry: m.HelloGeometry
    limits: m.HelloLimits
    processor_fault: ProcessorFault = NO_FAULT
    reset_cause: m.ResetCause | None = None  # None if no STATUS came with HELLO

    def is_same_robot(self, other: "RobotInfo") -> bool:
        """Whether the other one may be this robot, possibly after a reset."""
        return self == other._replace(processor_fault=self.processor_fault, reset_cause=self.reset_cause)

    @property
    def has_power_stage(self) -> bool:
        """Whether the robot drives real motors."""
        return bool(self.capabilities & Capability.POWER_STAGE)

    def describe(self) -> str:
        return (
            f"firmware {self.firmware} (build {self.build:08x}), capabilities {self.capabilities:#06x}, parameters "
            f"{self.parameter_hash:08x}, watchdog {self.watchdog_ms} ms, wheels of "
            f"{self.geometry.wheel_radius_m:.3f} m at ±{self.geometry.half_length_m:.3f}, "
            f"±{self.geometry.half_width_m:.3f} m, speeds up to {self.limits.speed_limit_rad_s:.4g} rad/s"
            f"{self._last_reset()}"
        )

    def warnings(self, newer_cause: m.ResetCause | None, ours_rad_s: float) -> tuple[str, ...]:
        """Return a warning if the last reset had a bad cause, and one if the robot's speed limit is too low.

        ``newer_cause`` is the reset cause of a STATUS after the handshake; ``ours_rad_s`` is the scenario's limit.
        """
        sentences = []
        cause = self.reset_cause if newer_cause is None else newer_cause
        if cause in _TROUBLE:
            words = reset_words(cause, self.processor_fault)
            sentences.append(f"the robot was reset since it was powered on ({cause.name}): {words}; find the cause")
        if self.limits.speed_limit_rad_s < ours_rad_s:
            sentences.append(
                f"the robot accepts wheel speeds of at most {self.limits.speed_limit_rad_s:.4g} rad/s, because "
                f"{self.limits.overspeed_rad_s:.4g} rad/s are a fault there; commands are limited to that and not to "
                f"robot.speed_limit_rad_s = {ours_rad_s:g}"
            )
        return tuple(sentences)

    def _last_reset(self) -> str:
        if self.processor_fault == NO_FAULT and self.reset_cause is None:
            return ""
        cause = m.ResetCause.PROCESSOR_FAULT if self.reset_cause is None else self.reset_cause
        return f"; last reset {cause.name}: {reset_words(cause, self.processor_fault)}"


class Expected(NamedTuple):
    """What the host requires of the robot before anything moves."""

    parameter_hash: int
    lockstep: bool
    allow_motion: bool
    speed_limit_rad_s: float  # the scenario's; the robot's own may be smaller


class Greeting:
    """Collects the HELLO pages. It does no I/O, so the caller may wait or may keep its control loop running."""

    def __init__(self) -> None:
        self._pages: dict[type, codec.Message] = {}
        self._status: m.Status | None = None

    @property
    def frames(self) -> list[Frame]:
        return [codec.encode(page) for page in self._pages.values()]

    def feed(self, message: codec.Message | None) -> RobotInfo | None:
        """Add a message. Once all pages are there, each page or STATUS returns the robot's info; else None.

        Raises BadInputError when the robot uses another version of the protocol.
        """
        if isinstance(message, m.HelloIdentity):
            # Page 0 is the same in all versions of the protocol; the other pages may differ.
            _check_version(message)
        if isinstance(message, m.Status):
            self._status = message
        elif isinstance(message, _PAGES):
            self._pages[type(message)] = message
        else:
            return None
        return self._info() if len(self._pages) == len(_PAGES) else None

    def _info(self) -> RobotInfo:
        identity, firmware, held, geometry, limits, status, place, address = (self._pages[kind] for kind in _PAGES)
        assert isinstance(identity, m.HelloIdentity)
        assert isinstance(firmware, m.HelloFirmware)
        assert isinstance(held, m.HelloParameters)
        assert isinstance(geometry, m.HelloGeometry)
        assert isinstance(limits, m.HelloLimits)
        assert isinstance(status, m.HelloFaultStatus)
        assert isinstance(place, m.HelloFaultPlace)
        assert isinstance(address, m.HelloFaultAddress)
        version = f"{firmware.major}.{firmware.minor}.{firmware.patch}"
        return RobotInfo(
            identity.capabilities,
            version,
            firmware.build,
            held.parameter_hash,
            held.watchdog_ms,
            geometry,
            limits,
            ProcessorFault(*status, *place, *address),
            None if self._status is None else m.ResetCause(self._status.reset_cause),
        )


def greet(link: Link, greeting: Greeting, *, status: bool = False) -> RobotInfo:
    """Request the HELLO pages until all have come. With ``status`` wait for a STATUS too, up to 0.2 s longer.

    Raises DeviceError when the robot does not answer within 2 s, BadInputError when it uses another version.
    """
    before = link.rejected()
    received_frames = 0
    deadline_ns = time.monotonic_ns() + SILENCE_NS
    retry_ns = 0
    found: RobotInfo | None = None
    while (now_ns := time.monotonic_ns()) <= deadline_ns:
        if found is not None and (found.reset_cause is not None or not status or now_ns >= retry_ns):
            return found
        if now_ns >= retry_ns:
            link.send(codec.encode(m.HelloRequest(m.PROTOCOL_VERSION)))
            retry_ns = now_ns + RETRY_NS
        received = link.receive(RETRY_NS)
        for frame in received.frames if received is not None else ():
            received_frames += 1
            found = greeting.feed(codec.decode(frame)) or found
    rejected = {cause: count - before.get(cause, 0) for cause, count in link.rejected().items()}
    raise DeviceError(
        f"the robot did not answer HELLO within 2 s ({link.describe()}); {_why_silent(received_frames, rejected)}"
    )


def _why_silent(received_frames: int, rejected: Mapping[str, int]) -> str:
    """Return the likely cause of a failed handshake, judged by the traffic, and what to do."""
    bus_errors = sum(count for cause, count in rejected.items() if cause.startswith("error_"))
    noise = rejected.get("cobs", 0) + rejected.get("crc", 0) + rejected.get("overrun", 0)
    foreign = rejected.get("foreign", 0) + rejected.get("unknown_id", 0)
    if received_frames:
        return f"{received_frames} frames of a robot came, but not its HELLO; reset the robot and try again"
    if rejected.get("error_acknowledgement") and bus_errors == rejected["error_acknowledgement"]:
        return "no device on the bus acknowledges our frames; check the robot's power, the cable and the bit rate"
    if bus_errors and not foreign:
        return (
            f"{bus_errors} error frames came and no valid one: the bit rate is wrong, or a terminator is missing; "
            "set bitrate= in the link to the robot's"
        )
    if noise:
        return (
            f"bytes came, but {noise} frames were damaged: set baud= in the link to the robot's rate, and close any "
            "other program that reads the port"
        )
    if foreign:
        return f"{foreign} frames of other devices came, so the bus works; check that the robot is on and on this bus"
    return (
        "check that it is powered, that the link is the right one, that no other program uses it, and the baud or "
        "bit rate"
    )


def _check_version(identity: m.HelloIdentity) -> None:
    if identity.protocol_version != m.PROTOCOL_VERSION or identity.schema_hash != m.SCHEMA_HASH:
        raise BadInputError(
            f"the robot uses protocol {identity.protocol_version} with schema {identity.schema_hash:08x}, this host "
            f"{m.PROTOCOL_VERSION} with {m.SCHEMA_HASH:08x}; flash the firmware of this package's version, or install "
            "the package of the firmware's version"
        )


def check(info: RobotInfo, expected: Expected) -> None:
    """Raise BadInputError unless mode and parameters match the scenario, and real motors are allowed to move."""
    if info.has_power_stage and not expected.allow_motion:
        raise BadInputError(
            "the robot reports a power stage: real motors would move; add --allow-motion if it may move"
        )
    if bool(info.capabilities & Capability.LOCKSTEP) != expected.lockstep:
        ours, theirs = ("lockstep", "realtime") if expected.lockstep else ("realtime", "lockstep")
        raise BadInputError(
            f"this run is in mode {ours} and the robot in mode {theirs}; start both with the same --mode"
        )
    if info.parameter_hash != expected.parameter_hash:
        raise BadInputError(
            f"the robot's firmware parameters (hash {info.parameter_hash:08x}) are not the scenario's [firmware] "
            f"(hash {expected.parameter_hash:08x}); start both from the same scenario and overrides, or write them "
            "into the robot: hil params LINK --scenario SCENARIO, or --robot FILE"
        )
