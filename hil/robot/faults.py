"""Faults of a virtual robot and its plant. They become rows of a C shim that sits between firmware and plant.

The shim also wires encoders and IMU.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from hil.core.clock import TICK_NS
from hil.core.errors import BadInputError, nearest
from hil.core.types import WHEEL_NAMES
from hil.core.wheel_map import Wiring
from hil.faults.rows import FaultRow
from hil.plant import shim
from hil.plant.start import Settable

if TYPE_CHECKING:
    from hil.faults.kinds import ShimRows
    from hil.plant.fmu import FmuPlant
    from hil.plant.remote import RemotePlant


class Body(NamedTuple):
    """What faults need to know of the robot: its wiring, the geometry, whether contact is rigid."""

    wiring: Wiring
    half_length_m: float
    half_width_m: float
    has_rigid_contact: bool

    def wheel_centres_m(self) -> tuple[tuple[float, float], ...]:
        """Return the (forward, left) position of FL, FR, RR and RL in the body frame [m]."""
        l1, l2 = self.half_length_m, self.half_width_m
        return (l1, l2), (l1, -l2), (-l1, -l2), (-l1, l2)


class RobotFaults:
    """The faults of one virtual robot. The firmware calls ``exchange_address`` in place of the plant's exchange.

    No fault acts before ``begin``. Not thread-safe: only the thread that runs the robot may use it.

    Attributes:
        can_reset: whether a fault may switch the firmware off.
        has_switch: whether the firmware can be switched off from here at all.
        ahead: the firmware's count of ticks minus the plant's: 0 where both are switched on together.
    """

    def __init__(self, plant: "FmuPlant | RemotePlant", body: Body) -> None:
        self._plant = plant
        self._body = body
        self._ffi, self._lib = shim.load()
        self._faults = self._ffi.new("robot_faults *")
        self._memory: tuple[Any, ...] = ()
        self._accounts = 0
        self.has_switch, self.ahead = True, 0
        self.clear()

    @property
    def exchange_address(self) -> int:
        return shim.address("robot_faults_exchange")

    @property
    def context_address(self) -> int:
        return int(self._ffi.cast("uintptr_t", self._faults))

    def clear(self) -> None:
        """Remove all faults. To be called when the robot is at its start."""
        plant, cast = self._plant, self._ffi.cast
        self._memory = ()
        self._accounts = 0
        self.can_reset = False
        self._faults[0] = self._ffi.new("robot_faults *")[0]
        self._faults.exchange = cast("wheel_plant_exchange", plant.exchange_address)
        self._faults.context = cast("void *", plant.context_address)
        self._faults.set = cast("int (*)(void *, size_t, double)", plant.set_address)
        self._faults.pose = cast("const double *", plant.pose_address)
        self._wire(self._body.wiring)

    def _wire(self, wiring: Wiring) -> None:
        there, imu = self._faults.wiring, wiring.imu
        there.encoder_channel, there.encoder_sign = wiring.encoder_channels, wiring.encoder_signs
        there.imu_axis, there.imu_sign = imu.axis, imu.sign
        is_plain = wiring.encoder_channels == (0, 1, 2, 3) and not wiring.reversed_encoders and imu.is_identity
        there.differs = not is_plain

    def arm(self, rows: Sequence[FaultRow]) -> None:
        """Set the faults of robot and plant. To be called when the robot is at its start.

        Raises BadInputError with one line for each fault that this robot or its plant does not support.
        """
        from hil.faults.kinds import find

        found: list[dict[str, object]] = []
        problems = []
        for account, row in enumerate(rows):
            effect = find(row.kind, row.target).on_robot
            times = {"first": row.start_ns // TICK_NS, "end": -(-row.end_ns // TICK_NS), "account": account}
            try:
                if effect is None:
                    raise BadInputError("a virtual robot does not support it")
                found += [dict(part) | times for part in effect(self, row)]
            except BadInputError as error:
                problems.append(f"fault {row.kind} {row.target}: {error}")
        if problems:
            raise BadInputError("\n".join(problems))
        row_memory = self._ffi.new("robot_fault[]", found)
        accounts = self._ffi.new("robot_fault_account[]", len(rows))
        self.can_reset = any(part["kind"] == self._lib.ROBOT_FAULT_RESET for part in found)
        self._memory, self._accounts = (row_memory, accounts), len(rows)
        self._faults.account, self._faults.row, self._faults.rows = accounts, row_memory, len(found)

    def begin(self, tick: int) -> None:
        """Set the firmware tick at which the scenario's time starts."""
        self._lib.robot_faults_begin(self._faults, max(0, tick - self.ahead))

    def power_on(self) -> None:
        """Count the firmware's ticks from 0 again, because it was powered on."""
        self._lib.robot_faults_power_on(self._faults)

    @property
    def is_off(self) -> bool:
        """Whether a reset has switched the firmware off."""
        return bool(self._faults.is_off)

    @property
    def extra_ticks(self) -> int:
        """Plant ticks that the firmware did not count because of its slow clock."""
        return int(self._faults.extra_ticks)

    def applied(self) -> list[int]:
        return [int(self._memory[1][i].applied) for i in range(self._accounts)]

    # The effects of kinds, as rows of the shim (``FaultyRobot``)

    def reset(self) -> "ShimRows":
        if not self.has_switch:
            raise BadInputError("nothing here can reset a real board; leave the fault out")
        return ({"kind": self._lib.ROBOT_FAULT_RESET},)

    def add_to_gyro(self, bias_rad_s: float) -> "ShimRows":
        return ({"kind": self._lib.ROBOT_FAULT_GYRO_BIAS, "value": bias_rad_s},)

    def slow_clock(self, ppm: float) -> "ShimRows":
        return ({"kind": self._lib.ROBOT_FAULT_SLOW_CLOCK, "value": ppm},)

    def lose_counts(self, wheel: str, part: float) -> "ShimRows":
        channel = self._body.wiring.encoder_wheels.index(wheel)
        return ({"kind": self._lib.ROBOT_FAULT_LOST_COUNTS, "place": channel, "value": part},)

    def stop_motor(self, wheel: str) -> "ShimRows":
        channel = self._body.wiring.motors.wheel_of_channel.index(WHEEL_NAMES.index(wheel))
        return ({"kind": self._lib.ROBOT_FAULT_DEAD_MOTOR, "place": channel},)

    def load(self, row: FaultRow) -> "ShimRows":
        names = ("mass_kg", "inertia_kg_m2", "com_x_m", "com_y_m")
        mass, inertia, x, y = (self._find(name).start for name in names)
        whole = mass + row.value
        com_x, com_y = (mass * x + row.value * row.x_m) / whole, (mass * y + row.value * row.y_m) / whole
        inertia += mass * ((x - com_x) ** 2 + (y - com_y) ** 2)
        inertia += row.value * ((row.x_m - com_x) ** 2 + (row.y_m - com_y) ** 2)
        for name, value in zip(names, (whole, inertia, com_x, com_y), strict=True):
            yield from self.set(name, value)

    def scale_grip(self, row: FaultRow) -> "ShimRows":
        if self._body.has_rigid_contact:
            raise BadInputError('wheels with rigid contact never slip; add plant.start.contact = "slip"')
        from hil.faults.kinds import GRIP_VARIABLES

        circle = {"radius_m": row.radius_m, "x_m": row.x_m, "y_m": row.y_m}
        for name, (forward_m, left_m) in zip(GRIP_VARIABLES, self._body.wheel_centres_m(), strict=True):
            (part,) = self.set(name, self._find(name).start * row.value)
            yield part | circle | {"forward_m": forward_m, "left_m": left_m}

    def set(self, variable: str, value: float) -> tuple[dict[str, object]]:
        found = self._find(variable)
        if not found.low <= value <= found.high:
            raise BadInputError(
                f"{variable} = {value:g} is out of the FMU's range; expected {found.low:g} to {found.high:g}"
            )
        return ({"kind": self._lib.ROBOT_FAULT_SET, "place": found.place, "value": value, "base": found.start},)

    def _find(self, name: str) -> Settable:
        settable = self._plant.settable
        if name in settable:
            return settable[name]
        if not settable:
            raise BadInputError("the FMU has no variable that can change in a run; use another FMU, or remove the row")
        from hil.faults.kinds import PUSHES

        inputs = {f"push.{push}" for push in PUSHES}
        hint = nearest(name, settable.keys() - inputs) if name not in inputs else "; the FMU has no such input"
        raise BadInputError(f"the FMU has no tunable parameter or free input {name!r}{hint}")
