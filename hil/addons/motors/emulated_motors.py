"""Shared by the emulated motor controllers: the plant, the shafts and the speed loops."""

import math
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Generic, TypeVar

from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import Fault, FaultWheel, Mode, State, StopReason
from firmware_protocol.host import View
from hil.core.clock import TICK_NS
from hil.core.types import FourWheels
from hil.plant import shim
from hil.robot.driver import clamp, four

_TICK_S = TICK_NS * 1e-9
STILL: FourWheels = (0.0, 0.0, 0.0, 0.0)


class Shaft:
    """One wheel's encoder as a controller sees it: position without wraps, and the speed of a tracking observer.

    The observer is the usual one of two poles at ``bandwidth_rad_s``, discretised at 1 kHz.
    """

    def __init__(self, counts_per_revolution: int, bandwidth_rad_s: float) -> None:
        self._rad_per_count = math.tau / counts_per_revolution
        self._kp = 2.0 * bandwidth_rad_s
        self._ki = bandwidth_rad_s * bandwidth_rad_s
        self._count: int | None = None
        self._tracked_rad = 0.0
        self.position_rad = 0.0
        self.speed_rad_s = 0.0

    def sample(self, count: int) -> None:
        """Take the counter of 16 bits, once a tick; the first sample is position 0."""
        turned = 0 if self._count is None else (count - self._count + 0x8000 & 0xFFFF) - 0x8000
        self._count = count
        self.position_rad += turned * self._rad_per_count
        self._tracked_rad += self.speed_rad_s * _TICK_S
        error = self.position_rad - self._tracked_rad
        self._tracked_rad += self._kp * error * _TICK_S
        self.speed_rad_s += self._ki * error * _TICK_S


class SpeedLoop:
    """A proportional-integral speed loop with a torque limit and anti-windup. ``gains``: kp and ki, as given."""

    def __init__(self, kp_n_m_s_rad: float, ki_n_m_rad: float, limit_n_m: float) -> None:
        self.gains = kp_n_m_s_rad, ki_n_m_rad
        self._limit_n_m = limit_n_m
        self._integral_n_m = 0.0

    def reset(self) -> None:
        """Set the integral to zero."""
        self._integral_n_m = 0.0

    def torque(self, target_rad_s: float, speed_rad_s: float, feedforward_n_m: float = 0.0) -> float:
        """Return the torque of this tick [N·m]."""
        kp, ki = self.gains
        error = target_rad_s - speed_rad_s
        wanted = feedforward_n_m + kp * error + self._integral_n_m
        limited = clamp(wanted, self._limit_n_m)
        if wanted == limited or error * wanted < 0.0:
            self._integral_n_m += ki * error * _TICK_S
        return limited


class CurrentLoop:
    """A motor's current loop for a plant whose motors take voltages: that of our firmware (control.c), at 1 kHz.

    Makers' own run at 8 kHz and more. A voltage from current and back-EMF alone would use the measured speed, which is
    late. A wheel that speeds up would then lack torque: 3 N·m at 100 rad/s² with 13 ms.
    """

    def __init__(self, resistance_ohm: float, inductance_h: float, bandwidth_rad_s: float) -> None:
        # Within a tick the current goes a part of the way to where the voltage pulls it, and the loop wants it to go
        # another part of the way to the target.
        self._part = -math.expm1(-resistance_ohm * _TICK_S / inductance_h)
        self._gain = -resistance_ohm * math.expm1(-bandwidth_rad_s * _TICK_S) / self._part
        self._integral_v = 0.0

    def reset(self) -> None:
        """Set the integral to zero."""
        self._integral_v = 0.0

    def duty(self, target_a: float, current_a: float, back_emf_v: float, battery_v: float) -> float:
        """Return the duty of this tick, -1 to 1."""
        if battery_v <= 0.0:
            self.reset()
            return 0.0
        voltage = self._gain * (target_a - current_a) + self._integral_v + back_emf_v
        duty = clamp(voltage / battery_v, 1.0)
        # At full duty that is less than the error, and nothing winds up.
        self._integral_v += self._part * (duty * battery_v - back_emf_v - self._integral_v)
        return duty


def int16(value: float) -> int:
    """Return the whole part of a value, saturated to 16 bits."""
    return clamp(int(value), 32767, -32768)


SettingsT = TypeVar("SettingsT")


class EmulatedMotors(Generic[SettingsT]):
    """Emulated motor controllers of one maker, connected to a plant: a ``RobotNode``, as the host library's firmware.

    A maker's class defines its state (``power_on``), its reaction to a frame (``receive``) and its tick of 1 ms
    (``tick``), and sends frames with ``send``. For a serial line it overrides ``feed`` and ``take_bytes``.

    Attributes:
        settings: of [device.motors].
        values: the parameters of [firmware]; used are the torque constant, limits, encoder and loop gains.
        ticks: number of ticks of 1 ms since power-on.
        shafts: of the four channels.
        loops: of the four channels, with the gains and the limit of [firmware].
        current_a: measured currents of the four motors.
        battery_v: measured voltage.
        on_tick: called with this object after each tick.
    """

    def __init__(
        self,
        settings: SettingsT,
        values: Mapping[str, float],
        exchange_address: int,
        context_address: int,
        **_of_firmware: Any,  # for a robot with our own protocol alone: lockstep, sensors, stored parameters
    ) -> None:
        self.settings = settings
        self.values = values
        self._ffi, _ = shim.load()
        self._exchange = self._ffi.cast("wheel_plant_exchange", exchange_address)
        self._context = self._ffi.cast("void *", context_address)
        self._drive = self._ffi.new("wheel_drive *")
        self._sense = self._ffi.new("wheel_sense *")
        counts, bandwidth = int(values["counts_per_revolution"]), values["tracking_bandwidth_rad_s"]
        self.shafts = tuple(Shaft(counts, bandwidth) for _ in range(4))
        gains = values["speed_kp_n_m_s_rad"], values["speed_ki_n_m_rad"]
        self.loops = tuple(SpeedLoop(*gains, values["torque_limit_n_m"]) for _ in range(4))
        motor = values["motor_resistance_ohm"], values["motor_inductance_h"], values["current_bandwidth_rad_s"]
        self._current_loops = tuple(CurrentLoop(*motor) for _ in range(4))
        self.ticks = 0
        self.torque_n_m: FourWheels = STILL
        self.on_tick: Callable[[Any], None] = lambda _motors: None
        self._plant_failed = False
        self._unsent = 0
        self._outgoing: deque[Frame] = deque()
        self._sample(self._ffi.NULL)
        self.power_on()

    # Defined by a maker's class

    def power_on(self) -> None:
        """Set up the maker's own state; called once, at the end of the constructor."""
        raise NotImplementedError

    def receive(self, frame: Frame) -> None:
        """Do what a CAN frame asks. Ignore a frame that is not for this maker's devices."""
        raise NotImplementedError

    def tick(self) -> FourWheels | None:
        """Return the torques of this tick [N·m], or None if the drives are off; called before the plant's step."""
        raise NotImplementedError

    @property
    def is_driving(self) -> bool:
        """Whether any motor is held or driven."""
        raise NotImplementedError

    @property
    def speeds_rad_s(self) -> FourWheels:
        """The speeds of the four shafts, as the controllers measure them."""
        return four(shaft.speed_rad_s for shaft in self.shafts)

    def follow(self, targets_rad_s: FourWheels, torques_n_m: FourWheels = STILL) -> FourWheels:
        """Return the torques of the four speed loops in this tick [N·m]; ``torques_n_m`` are added to them."""
        wheels = zip(self.loops, targets_rad_s, self.speeds_rad_s, torques_n_m, strict=True)
        return four(loop.torque(target, speed, torque) for loop, target, speed, torque in wheels)

    def reset_loops(self) -> None:
        """Set the integrals of the speed loops to zero."""
        for loop in self.loops:
            loop.reset()

    def send(self, frame: Frame) -> None:
        self._outgoing.append(frame)

    # The node

    def feed(self, data: bytes) -> None:
        """Take bytes of a serial line: this maker's devices have none."""

    def take_bytes(self) -> bytes:
        """Return bytes for a serial line: this maker's devices have none."""
        return b""

    def take_frames(self) -> list[Frame]:
        frames = list(self._outgoing)
        self._outgoing.clear()
        return frames

    def count_unsent(self, frames: int) -> None:
        """Count frames that could not be sent, for ``look``; a real controller does not notice."""
        self._unsent += frames

    def set_clock(self, now_us: int) -> None:
        """Ignored: these controllers send no time stamps."""

    def run(self, ticks: int) -> None:
        """Let so many 1 ms ticks pass."""
        for _ in range(ticks):
            torque = self.tick()
            self.torque_n_m = torque or STILL
            drive = self._drive
            drive.tick = self.ticks
            drive.enabled = torque is not None
            drive.torque_n_m = self.torque_n_m
            if torque is None:
                for loop in self._current_loops:
                    loop.reset()
            drive.duty = STILL if torque is None else self._duty()
            self.ticks += 1
            self._sample(drive)
            self.on_tick(self)

    def stored(self) -> bytes | None:
        """Return None: after a reset only the settings remain, which are the scenario's."""
        return None

    def look(self) -> View:
        """Return the internal state in the terms of our own firmware."""
        return View(
            tick=self.ticks,
            state=State.ACTIVE if self.is_driving else State.IDLE,
            mode=Mode.SPEED,
            fault=Fault.NONE,
            fault_wheel=FaultWheel.NONE,
            stop_reason=StopReason.NONE,
            plant_failed=self._plant_failed,
            command_age_ticks=0,
            set_point_rad_s=STILL,
            torque_n_m=self.torque_n_m,
            duty=STILL,
            rejected={"transmit_overruns": self._unsent},
        )

    def _duty(self) -> FourWheels:
        """Return the duty (-1 to 1) that gives each torque, for a plant whose motors take voltages."""
        constant = self.values["torque_constant_n_m_a"]
        motors = zip(self._current_loops, self.torque_n_m, self.current_a, self.shafts, strict=True)
        return four(
            loop.duty(torque / constant, current_a, constant * shaft.speed_rad_s, self.battery_v)
            for loop, torque, current_a, shaft in motors
        )

    def _sample(self, drive: Any) -> None:
        sense = self._sense
        failed = self._exchange(self._context, drive, sense) != 0
        self._plant_failed = self._plant_failed or failed
        for shaft, count in zip(self.shafts, sense.count, strict=True):
            shaft.sample(count)
        unpack = self._ffi.unpack
        self.current_a: FourWheels = tuple(unpack(sense.current_a, 4))
        self.temperature_degc: FourWheels = tuple(unpack(sense.temperature_degc, 4))
        self.gyro_rad_s: tuple[float, float, float] = tuple(unpack(sense.gyro_rad_s, 3))
        self.acceleration_m_s2: tuple[float, float, float] = tuple(unpack(sense.acceleration_m_s2, 3))
        self.battery_v: float = sense.battery_v
        self.battery_a: float = sense.battery_a
