"""The virtual STM32: the firmware core, compiled into the host library, connected to the plant FMU."""

import contextlib
import functools
import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

from firmware_protocol.built import BuildError
from firmware_protocol.capabilities import Capability
from firmware_protocol.host import HostNode, View
from hil.core.errors import BadInputError, DeviceError
from hil.core.ports import Node
from hil.core.types import FourWheels
from hil.plant import archive
from hil.plant.child_output import ChildOutput
from hil.plant.fmu import FmuPlant
from hil.plant.mapping import SignalMap
from hil.robot.faults import Body, RobotFaults

if TYPE_CHECKING:
    from hil.plant.remote import RemotePlant

_SENSORS = {
    "accelerometer": Capability.ACCELEROMETER,
    "battery": Capability.POWER,
    "temperatures": Capability.TEMPERATURES,
}


class RobotNode(Node, Protocol):
    """A robot's firmware or motor controllers, on this machine: ``HostNode``, an emulated board, emulated devices."""

    def run(self, ticks: int) -> None:
        """Run a number of 1 ms ticks."""

    def stored(self) -> bytes | None:
        """Return the stored parameters (the newest STORE), which survive a reset, or None."""

    def look(self) -> View:
        """Return the firmware's internal state, as far as it is known."""


class VirtualPlant(NamedTuple):
    """The plant of a virtual robot: the arguments of ``FmuPlant`` and ``RemotePlant``."""

    fmu: Path
    start: Mapping[str, float | bool | str]
    mapping: SignalMap
    timeout_s: float
    memory_limit_mb: float


class VirtualRobot(NamedTuple):
    """The configuration of a virtual robot."""

    plant: VirtualPlant
    firmware: Mapping[str, float]
    lockstep: bool
    body: Body


@runtime_checkable
class ClockedNode(RobotNode, Protocol):
    """A firmware that can run in real time: its clock can be set between two ticks."""

    def set_clock(self, now_us: int) -> None:
        """Set the robot's clock [µs], which gives the times of received and sent frames."""


class EmulatedShaft(Protocol):
    """One wheel's shaft, as an emulated controller measures it."""

    speed_rad_s: float


class EmulatedDevice(ClockedNode, Protocol):
    """Emulated motor controllers of one maker, connected to a plant.

    Attributes:
        torque_n_m: what the drives gave in the newest tick.
        on_tick: called with this object after each tick.
    """

    torque_n_m: FourWheels
    on_tick: Callable[[Any], None]

    @property
    def shafts(self) -> Sequence[EmulatedShaft]:
        """The shafts of the four channels."""


MakeNode = Callable[..., ClockedNode]
"""Makes a firmware from the arguments of ``HostNode``: that class, one that watches it, or emulated controllers."""


class VirtualStm32:
    """A robot on this machine: one firmware and one plant.

    The shipped FMU runs in this process; any other FMU may crash or hang, so it runs in its own process. ``make_node``
    makes the firmware, again at every power-on.

    ``output`` is that of a plant in its own process, with notices of how it is used; None where there are neither.

    Raises BadInputError when the FMU cannot be used or a firmware parameter is out of range; DeviceError when the FMU
    fails while it is opened.
    """

    output: ChildOutput | None

    def __init__(self, made_of: VirtualRobot, make_node: MakeNode = HostNode) -> None:
        self._made_of = made_of
        self._make_node = make_node
        with contextlib.ExitStack() as resources:
            self.plant = _open(made_of.plant)
            resources.callback(self.plant.close)
            self._tell()
            self._wire(made_of)
            self._stored: bytes | None = None
            self.faults = RobotFaults(self.plant, made_of.body)
            self.node = self._power_on()
            resources.pop_all()

    def _tell(self) -> None:
        plant = self.plant
        self.output = plant.output
        if self.output is None and plant.notices:  # an empty output is false
            self.output = ChildOutput()
        if self.output is not None:
            self.output.feed("".join(f"{notice}\n" for notice in plant.notices).encode())
            self.output.forget_newest()

    def _wire(self, made_of: VirtualRobot) -> None:
        motors = made_of.body.wiring.motors
        self.plant.wire(motors.wheel_of_channel, motors.sign_of_channel)

    def _power_on(self) -> RobotNode:
        plant, made_of = self.plant, self._made_of
        try:
            return self._make_node(
                made_of.firmware,
                self.faults.exchange_address,
                self.faults.context_address,
                lockstep=made_of.lockstep,
                lacks=functools.reduce(operator.or_, (_SENSORS[name] for name in plant.lacks), Capability(0)),
                stored=self._stored,
            )
        except (ValueError, BuildError) as error:
            raise BadInputError(f"the virtual robot cannot start: {error}") from error

    def power_cycle(self) -> None:
        """Reset the plant to its start and the firmware to its power-on state, and remove all faults."""
        self._power_off()
        self.plant.reset()
        self.faults.clear()
        self.node = self._power_on()

    def remake(self, made_of: VirtualRobot, make_node: MakeNode) -> None:
        """Become another, new robot without stored parameters, but keep the FMU open; see ``FmuPlant.restart``.

        Raises as the constructor does. After an error the robot can only be closed.
        """
        if isinstance(self.plant, FmuPlant):
            self.plant.restart(made_of.plant.start)
        else:
            self.plant.reset()
        self._tell()
        self._wire(made_of)
        self._made_of, self._make_node, self._stored = made_of, make_node, None
        self.faults = RobotFaults(self.plant, made_of.body)
        self.node = self._power_on()

    def can_become(self, made_of: VirtualRobot) -> bool:
        """Whether ``remake`` can turn this robot into that one.

        It cannot if the FMU is another one, or if its start values differ and it runs in its own process. A foreign FMU
        is opened again too, because its reset may be incomplete.
        """
        here, there = self._made_of.plant, made_of.plant
        if isinstance(self.plant, FmuPlant):
            here = here._replace(start=there.start)
        return here == there and archive.is_ours(there.fmu) and self.failure() is None

    def restart(self) -> None:
        """Reset the firmware to its power-on state. The plant does not change, and stored parameters are kept."""
        self._power_off()
        self.faults.power_on()
        self.node = self._power_on()

    def awake(self) -> RobotNode:
        """Return the firmware. If a reset fault has switched it off, it is first switched on again."""
        if self.faults.is_off:
            self.restart()
        return self.node

    def _power_off(self) -> None:
        self._stored = self.node.stored()

    def failure(self) -> DeviceError | None:
        """Return an error with the FMU's message if the plant has failed, else None."""
        if not self.node.look().plant_failed:
            return None
        at_s = self.plant.truth().time_ns * 1e-9
        return DeviceError(f"the plant {self._made_of.plant.fmu.name} failed at {at_s:g} s: {self.plant.message}")

    def close(self) -> None:
        self.plant.close()


MakeRobot = Callable[[VirtualRobot, MakeNode], AbstractContextManager[VirtualStm32]]
"""Makes a virtual robot for a run; the end of the context gives it back."""


def new_robot(made_of: VirtualRobot, make_node: MakeNode) -> AbstractContextManager[VirtualStm32]:
    """Make a robot for one run. Raises as ``VirtualStm32`` does."""
    return contextlib.closing(VirtualStm32(made_of, make_node))


class KeptRobot:
    """Makes the robots of many runs, one after the other, and keeps the FMU open between them if possible."""

    def __init__(self) -> None:
        self._robot: VirtualStm32 | None = None

    @contextlib.contextmanager
    def robot(self, made_of: VirtualRobot, make_node: MakeNode) -> Iterator[VirtualStm32]:
        """Yield a robot in the state of a new one. Raises as ``VirtualStm32`` does."""
        robot, self._robot = self._robot, None
        with contextlib.ExitStack() as resources:
            if robot is not None:
                resources.callback(robot.close)
            if robot is not None and robot.can_become(made_of):
                robot.remake(made_of, make_node)
            else:
                resources.close()
                robot = VirtualStm32(made_of, make_node)
                resources.callback(robot.close)
            yield robot
            resources.pop_all()
        self._robot = robot

    def close(self) -> None:
        if self._robot is not None:
            self._robot.close()
            self._robot = None


def _open(plant: VirtualPlant) -> "FmuPlant | RemotePlant":
    if archive.is_shipped(plant.fmu):
        return FmuPlant(plant.fmu, plant.start, mapping=plant.mapping)
    from hil.plant.remote import RemotePlant  # only for a foreign FMU

    return RemotePlant(
        plant.fmu,
        plant.start,
        mapping=plant.mapping,
        timeout_s=plant.timeout_s,
        memory_limit_mb=plant.memory_limit_mb,
    )
