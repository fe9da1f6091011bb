"""Four free wheels on a test stand behind the firmware core: the simplest plant there is, for tests of the node."""

import itertools
import math

from firmware_protocol import codec
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from firmware_protocol.host import parameter_hash
from tests.suite.plant_node import PlantNode

PARAMETERS = {
    "counts_per_revolution": 4096.0,
    "wheel_radius_m": 0.075,
    "half_length_m": 0.3,
    "half_width_m": 0.3,
    "tracking_bandwidth_rad_s": 150.0,
    "speed_kp_n_m_s_rad": 1.1,
    "speed_ki_n_m_rad": 25.0,
    "torque_limit_n_m": 5.0,
    "torque_constant_n_m_a": 1.25,
    "motor_resistance_ohm": 0.6,
    "motor_inductance_h": 5e-4,
    "current_limit_a": 20.0,
    "current_bandwidth_rad_s": 1000.0,
    "temperature_limit_degc": 120.0,
    "undervoltage_v": 0.0,
    "overspeed_rad_s": 100.0,
    "encoder_fault_s": 0.1,
    "watchdog_s": 0.05,
    "ramp_s": 0.2,
    "feedback_period_s": 0.005,
}
REST_TICKS = 51  # after which wheels that stand still are known to rest, and the drives are off
INERTIA_KG_M2 = 0.033  # a quarter of 23.6 kg on a wheel of 75 mm


class WheelRig:
    """A firmware core that drives four wheels; frames go in and messages come out."""

    def __init__(
        self,
        *,
        lockstep: bool = False,
        power_stage: bool = False,
        stored: bytes | None = None,
        **parameters: float,
    ) -> None:
        self.values = PARAMETERS | parameters
        self.angle_rad = [0.0] * 4
        self.speed_rad_s = [0.0] * 4
        self.torque_n_m = [0.0] * 4
        self.fail = False
        self.duty = [0.0] * 4
        self.enabled = False
        self.current_a = [0.0] * 4
        self.battery_v = 24.0
        self.temperature_degc = [25.0] * 4
        self.held = [False] * 4  # wheels that keep the speed they have: blocked, or towed
        self.encoder_sign = [1] * 4
        self.encoder_dead = [False] * 4
        self.count = [0] * 4
        self.override: dict[str, tuple[int, float]] = {}  # a sensor's value, by its name and place
        self.node = PlantNode(self._plant, self.values, lockstep=lockstep, power_stage=power_stage, stored=stored)
        self.nonces = itertools.count(0x1231)
        self.nonce = 0

    def _plant(self, _context, drive, sense) -> int:
        if drive:
            self.torque_n_m = list(drive.torque_n_m)
            self.duty = list(drive.duty)
            self.enabled = bool(drive.enabled)
            for i in range(4):
                self.speed_rad_s[i] += 0.0 if self.held[i] else self.torque_n_m[i] / INERTIA_KG_M2 * 1e-3
                self.angle_rad[i] += self.speed_rad_s[i] * 1e-3
        for i in range(4):
            if not self.encoder_dead[i]:
                self.count[i] = self.encoder_sign[i] * math.floor(self.angle_rad[i] / math.tau * 4096) & 0xFFFF
            sense.count[i] = self.count[i]
            sense.current_a[i] = self.current_a[i]
            sense.temperature_degc[i] = self.temperature_degc[i]
        sense.battery_v = self.battery_v
        sense.acceleration_m_s2[2] = 9.81
        for name, (place, value) in self.override.items():
            if name.startswith("battery"):
                setattr(sense, name, value)
            else:
                getattr(sense, name)[place] = value
        return int(self.fail)

    def send(self, message: codec.Message) -> None:
        self.node.receive(codec.encode(message))

    def heard(self) -> list[codec.Message]:
        return [message for frame in self.node.take_frames() if (message := codec.decode(frame)) is not None]

    def frames(self) -> list[Frame]:
        return self.node.take_frames()

    def run(self, ticks: int) -> None:
        self.node.run(ticks)

    @property
    def state(self) -> m.State:
        return self.node.look().state

    def heartbeat(self, request: m.Request, nonce: int, mode: m.Mode = m.Mode.SPEED) -> None:
        check = parameter_hash(self.values) & 0xFF
        self.send(m.HostHeartbeat(nonce, m.SCHEMA_HASH, request, mode, check))

    def arm(self, mode: m.Mode = m.Mode.SPEED, nonce: int | None = None) -> None:
        """Announce a nonce and arm with it."""
        self.nonce = next(self.nonces) if nonce is None else nonce
        self.heartbeat(m.Request.IDLE, self.nonce, mode)
        self.heartbeat(m.Request.ARM, self.nonce, mode)

    def command(self, value: float, sequence: int, session: int | None = None) -> None:
        session = self.nonce & 0xF if session is None else session
        self.send(m.WheelCommand(value, value, value, value, sequence & 0xFF, session))

    def torque(self, value: float, sequence: int) -> None:
        self.send(m.TorqueCommand(value, value, value, value, sequence & 0xFF, self.nonce & 0xF))

    def activate(self, mode: m.Mode = m.Mode.SPEED) -> None:
        """Arm and send the zero command, sequence 0."""
        self.arm(mode)
        if mode is m.Mode.SPEED:
            self.command(0.0, 0)
        else:
            self.torque(0.0, 0)
        assert self.state is m.State.ACTIVE

    def drive(self, value: float, ticks: int, first_sequence: int = 1) -> int:
        """Command a speed every 5 ticks; return the next sequence."""
        sequence = first_sequence
        for _ in range(ticks // 5):
            self.command(value, sequence)
            self.run(5)
            sequence += 1
        return sequence
