"""Drives the channels of a robot whose wiring is unknown, by open-loop torque, and records what its sensors saw.

Everything goes over the robot's own link and protocol. The firmware's speed loop has gains of zero meanwhile, and no
brake of the host acts, so that nothing is closed-loop before its sign is known, not even after a lost link. A channel
is braked by its speed only once its encoder is known (``Encoders``).
"""

import contextlib
import math
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from firmware_protocol.generated.messages import State
from hil.core.errors import DeviceError, HilError
from hil.core.types import ZERO_WHEELS, CommandMode, WheelCommand, Wheels
from hil.robot.driver import clamp
from hil.robot.snapshot import Feedback
from hil.runtime.bench import NS, Bench
from hil.runtime.freshness import Freshness
from hil.runtime.sampling import Timing
from hil.scenario import Scenario

Array = npt.NDArray[np.float64]


class Record(NamedTuple):
    """The measurements of one drive: a row a period, a column a channel; NaN for missing ones.

    Attributes:
        t_s: since its beginning.
        torque_n_m: commanded for the period that begins then.
        turned_rad: angle since the beginning, by the encoders' inputs and the believed counts.
        speed_rad_s: as the robot reports it.
        current_a: likewise.
        acceleration_m_s2: of the IMU's three axes.
        yaw_rate_rad_s: about the IMU's third axis.
        was_cut: whether a limit ended it early.
    """

    t_s: Array
    torque_n_m: Array
    turned_rad: Array
    speed_rad_s: Array
    current_a: Array
    acceleration_m_s2: Array
    yaw_rate_rad_s: Array
    was_cut: bool

    @property
    def fastest_rad_s(self) -> float:
        """The largest speed of any wheel."""
        return float(np.abs(self.speed_rad_s).max(initial=0.0))


class Encoders:
    """The known wiring of the encoders: for each channel its input, and its sign against the channel's motor."""

    def __init__(self, inputs: Sequence[int | None] = (None,) * 4, signs: Sequence[int] = (1,) * 4) -> None:
        self.inputs = list(inputs)
        self.signs = list(signs)

    def of_motors(self, by_input: Sequence[float]) -> list[float]:
        """Return values of the encoders' inputs, as the channels' motors count them; 0 for one that is not known."""
        pairs = zip(self.inputs, self.signs, strict=True)
        return [0.0 if place is None else sign * by_input[place] for place, sign in pairs]

    def input_of(self, channel: int) -> int:
        """Return the input of a channel's encoder, which must be known."""
        place = self.inputs[channel]
        assert place is not None
        return place


_Row = tuple[float, Feedback, Sequence[float]]
Drive = Callable[[float, Feedback], Sequence[float]]
"""What a pulse commands: the torques of the four channels at a time [s], given the newest feedback."""

_STILL_RAD_S = 0.15
_STILL_S = 0.2
_SETTLE_S = 3.0
_BRAKE_S = 0.15  # time constant with which a free wheel, or the whole robot, is braked once its encoders are known
_STOP_NS = 5 * NS
_HALF = 1 << 15


class Session:
    """A robot's link, open for commissioning until ``close``. The scenario must be of mode TORQUE.

    Raises as ``Bench`` does.

    Attributes:
        bench: the bench of the run.
        torque_limit_n_m: the largest torque of a channel that both ends allow.
        encoders: what is known of them, for braking.
        is_on_blocks: whether the robot stands on blocks.
        furthest_m: the longest way of any wheel's rim in one pulse so far.
        fastest_rad_s: the largest wheel speed so far, by the robot's own report.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.torque_limit_n_m = min(scenario.robot.torque_limit_n_m, scenario.firmware.torque_limit_n_m)
        self.bench = Bench(scenario, None, allow_motion=True, wiring_is_unknown=True)
        self.encoders, self.is_on_blocks = Encoders(), True
        self.furthest_m = self.fastest_rad_s = 0.0
        self._newest: tuple[int, ...] | None = None
        self._counted = [0] * 4
        self.firmware = ""
        self._period_ns = scenario.loop.period_ns
        self._per_count = math.tau / scenario.firmware.counts_per_revolution

    def connect(self) -> Sequence[str]:
        """Shake hands; return the warnings for the user. Nothing moves."""
        device = self.bench.device
        self.firmware = self.bench.connect().describe()
        device.attend(self.bench.clock)
        self._clear_latched()
        return device.warnings

    def _clear_latched(self) -> None:
        """End an e-stop or a fault that an earlier try has left; that arms nothing."""
        device, period_ns = self.bench.device, self._period_ns
        begin_ns = self.bench.clock.now_ns()
        is_cleared = False
        for n in range(1, 1 + NS // period_ns):
            device.wait_until(begin_ns + n * period_ns)
            feedback = device.poll()
            if feedback is None:
                continue
            if feedback.state not in (State.FAULT, State.ESTOP):
                break
            if not is_cleared:
                device.clear()
                is_cleared = True
        if is_cleared:
            device.disarm()

    @property
    def period_s(self) -> float:
        """The period of commands [s]."""
        return self._period_ns / NS

    @property
    def delay_s(self) -> float:
        """How late feedback may be [s]."""
        return self.scenario.link.command_latency_s + self.scenario.link.feedback_latency_s + 3 * self.period_s

    # At rest

    def listen(self, seconds: float) -> Record:
        """Record the robot without arming it. Raises DeviceError when it sends no feedback."""
        rows: list[_Row] = []
        device, begin_ns = self.bench.device, self.bench.clock.now_ns()
        for n in range(1, 1 + round(seconds * NS) // self._period_ns):
            device.wait_until(begin_ns + n * self._period_ns)
            if (feedback := device.poll()) is not None:
                self._follow(feedback)
                rows.append((n * self._period_ns / NS, feedback, (0.0,) * 4))
        if not rows:
            raise DeviceError("the robot sends no feedback; look at its power and at the link")
        return self._record(rows, was_cut=False)

    def angles(self) -> tuple[float, ...]:
        """Return the angles [rad] of the encoders' inputs since the connection, of a robot that is not armed."""
        self.listen(0.3)
        return tuple(count * self._per_count for count in self._counted)

    def listen_while(self, ask: Callable[[], None]) -> None:
        """Ask a person, and go on listening to a real robot meanwhile: its counters wrap while it is pushed."""
        if self.bench.device.is_lockstep:
            ask()
            return
        problems: list[BaseException] = []

        def asked() -> None:
            try:
                ask()
            except BaseException as error:  # noqa: BLE001 - raised below, in the thread that asked
                problems.append(error)

        thread = threading.Thread(target=asked, daemon=True)
        thread.start()
        while thread.is_alive():
            self.listen(0.1)
        if problems:
            raise problems[0]

    def _follow(self, feedback: Feedback) -> None:
        counts = feedback.encoder_count
        if self._newest is not None:
            self._counted = [
                whole + _apart(now, then) for whole, now, then in zip(self._counted, counts, self._newest, strict=True)
            ]
        self._newest = counts

    # Armed

    @contextlib.contextmanager
    def armed(self) -> Iterator[None]:
        """Arm at zero; at the end wait until the wheels rest, and disarm. After an error the drives are off."""
        device, period_ns = self.bench.device, self._period_ns
        begin_ns = device.start(self.bench.clock, period_ns)
        stale_ns = round(self.scenario.firmware.watchdog_s * NS)
        self._freshness = Freshness(self.bench.clock, device, None, Timing(period_ns, 0, 0, stale_ns))
        self._next_ns = begin_ns
        try:
            yield
            self.rest()
        except BaseException:
            with contextlib.suppress(HilError):
                device.estop()
                device.wait_until(self.bench.clock.now_ns() + period_ns)
                device.estop()
            raise
        if not device.stop(period_ns, _STOP_NS):
            raise DeviceError("the robot did not come to rest within 5 s; cut the motors' power")

    def drive(self, command: Drive, seconds: float, *, cut_rad_s: float, cut_rad: float = math.inf) -> Record:
        """Command for so long, then zero. It ends early where a wheel is faster, or turned further, than the cut.

        To be called within ``armed``. Raises DeviceError and LinkError when the robot refuses, stops or is lost.
        """
        device, rows, was_cut = self.bench.device, [], False
        first: tuple[int, ...] | None = None
        for n in range(round(seconds * NS) // self._period_ns):
            feedback = self._tick()
            first = first or feedback.encoder_count
            t_s = n * self._period_ns / NS
            turned = max(abs(_apart(now, then)) for now, then in zip(feedback.encoder_count, first, strict=True))
            if max(map(abs, feedback.speed_rad_s)) > cut_rad_s or turned * self._per_count > cut_rad:
                was_cut = True
                break
            torques = command(t_s, feedback)
            self._send(torques)
            rows.append((t_s, feedback, torques))
        self._send((0.0,) * 4)
        if not rows:
            raise DeviceError("a wheel turns already before anything is commanded; hold the robot still and try again")
        record = self._record(rows, was_cut=was_cut)
        self.fastest_rad_s = max(self.fastest_rad_s, record.fastest_rad_s)
        way_m = float(np.abs(record.turned_rad).max()) * self.scenario.robot.wheel_radius_m
        self.furthest_m = max(self.furthest_m, way_m)
        device.poll()
        return record

    def rest(self) -> None:
        """Brake wheels whose encoder is known, and wait until all rest."""
        robot = self.scenario.robot
        share = robot.wheel_inertia_kg_m2 + (0.0 if self.is_on_blocks else robot.mass_kg * robot.wheel_radius_m**2 / 4)
        gain, limit = share / _BRAKE_S, 0.3 * robot.torque_limit_n_m
        still = 0
        for _ in range(round(_SETTLE_S * NS) // self._period_ns):
            feedback = self._tick()
            rests = max(map(abs, feedback.speed_rad_s)) < _STILL_RAD_S
            still = still + 1 if rests else 0
            if still * self._period_ns > _STILL_S * NS:
                return
            speeds = self.encoders.of_motors(feedback.speed_rad_s)
            self._send([clamp(-gain * speed, limit) for speed in speeds])
        raise DeviceError(
            "the wheels do not come to rest although nothing drives them; if the robot stands on the floor, it slopes: "
            "choose a level one"
        )

    def _tick(self) -> Feedback:
        device = self.bench.device
        self._next_ns += self._period_ns
        device.wait_until(self._next_ns)
        if (failure := self.bench.robot_failure()) is not None:
            raise failure
        feedback = self._freshness.poll(self._next_ns / NS)
        self._follow(feedback)
        if self._freshness.is_silent():
            raise DeviceError(
                f"the feedback is {self._freshness.silent_ns * 1e-6:.0f} ms old: the link was lost; the drives were "
                "told to switch off, but nothing confirms it: cut the motors' power if a wheel turns"
            )
        return feedback

    def _send(self, torques_n_m: Sequence[float]) -> None:
        """Send the torques of the four channels, each limited to ``torque_limit_n_m``."""
        torques = Wheels(*(clamp(torque, self.torque_limit_n_m) for torque in torques_n_m))
        self.bench.device.send(WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, torques))

    def _record(self, rows: list[_Row], *, was_cut: bool) -> Record:
        t_s, feedbacks, torques = zip(*rows, strict=True)
        counts = np.array([feedback.encoder_count for feedback in feedbacks], dtype=np.int64)
        steps = (np.diff(counts, axis=0, prepend=counts[:1]) + _HALF) % (2 * _HALF) - _HALF
        names = ("speed_rad_s", "current_a", "acceleration_m_s2", "yaw_rate_rad_s")
        speed, current, acceleration, yaw_rate = (
            np.array([getattr(feedback, name) for feedback in feedbacks], dtype=float) for name in names
        )
        turned = np.cumsum(steps, axis=0) * self._per_count
        torque = np.array(torques, dtype=float)
        return Record(np.array(t_s), torque, turned, speed, current, acceleration, yaw_rate, was_cut)

    # A virtual robot in this process

    def lift(self, *, lifted: bool) -> None:
        """Say that the robot stands on blocks, or on the floor; a virtual robot in this process is put there.

        Raises BadInputError for a plant whose wheels cannot be lifted.
        """
        self.is_on_blocks = lifted
        if self.bench.local is not None:
            self.bench.local.set_variables({f"wheel.{wheel}.lifted": float(lifted) for wheel in Wheels._fields})

    def close(self) -> None:
        """Close everything."""
        self.bench.close()


def _apart(now: int, then: int) -> int:
    """Return the difference of two counters of 16 bits."""
    return (now - then + _HALF) % (2 * _HALF) - _HALF
