"""What commissioning has found so far: kept in the robot's file, and said in sentences."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from hil.addons.identify.commission.commission_session import Encoders
from hil.addons.identify.commission.wirings import Candidate, WheelSeen
from hil.core.types import WHEEL_NAMES
from hil.scenario.commission import CommissionTable, State, Way
from hil.scenario.tables import DeviceTable
from hil.scenario.values import Wheel

STEPS = ("blocks", "floor", "check", "push")  # the steps that are kept; the robot at rest is looked at each time


@dataclass
class Findings:
    """What was found, a part a step. ``values`` are keys of the robot's own tables that follow from it.

    ``imu`` are the axes of the IMU: those of the robot's file, until others are found.
    """

    table: CommissionTable = field(default_factory=CommissionTable)
    candidate: Candidate | None = None
    values: dict[str, object] = field(default_factory=dict)
    imu: tuple[str, str, str] = ("x", "y", "z")

    @classmethod
    def kept(cls, table: CommissionTable, device: DeviceTable) -> "Findings":
        """Return the findings in a robot's file; none for a robot that is done or had to be rewired."""
        if table.state != "begun":
            return cls(imu=device.imu)
        candidate = None
        if "floor" in table.steps and table.rollers is not None:
            wheels = tuple(WHEEL_NAMES.index(wheel) for wheel in device.wheels)
            signs = tuple(-1 if wheel in device.reversed else 1 for wheel in device.wheels)
            candidate = Candidate(wheels, signs, table.rollers, 0)
        return cls(table, candidate, imu=device.imu)

    @property
    def told(self) -> WheelSeen | None:
        """What the person saw of the first output."""
        wheel, way = self.table.first_wheel, self.table.first_way
        if wheel is None or way is None:
            return None
        return WheelSeen(0, WHEEL_NAMES.index(wheel), 1 if way == "forward" else -1)

    @property
    def encoders(self) -> Encoders:
        """The encoders, as far as they are known."""
        if not self.table.encoders:
            return Encoders()
        return Encoders([place - 1 for place in self.table.encoders], self.table.encoder_signs)

    def saw(self, encoders: Encoders, wheel: Wheel, way: Way) -> None:
        """Keep what was found on blocks."""
        self.table = replace(
            self.table,
            encoders=tuple(encoders.input_of(channel) + 1 for channel in range(4)),
            encoder_signs=tuple(encoders.signs),
            first_wheel=wheel,
            first_way=way,
        )

    def decided(self, candidate: Candidate, imu: tuple[str, str, str] | None) -> None:
        """Keep the wiring, and say what has to be changed at the robot."""
        self.candidate = candidate
        self.table = replace(self.table, rollers=candidate.rollers, todo=tuple(self._todo(candidate)))
        self.values |= {"device.wheels": candidate.wheel_names, "device.reversed": candidate.reversed_wheels}
        if imu is not None:
            self.imu = self.values["device.imu"] = imu

    def _todo(self, candidate: Candidate) -> list[str]:
        todo = []
        places = zip(candidate.wheel_names, self.table.encoders, self.table.encoder_signs, strict=True)
        for channel, (wheel, place, sign) in enumerate(places, start=1):
            if place != channel:
                todo.append(
                    f"the encoder of {wheel}, motor output {channel}, is at input {place}: connect it to {channel}"
                )
            if sign < 0:
                todo.append(f"the encoder of {wheel} counts against its motor: exchange its lines A and B")
        if candidate.rollers == "o":
            todo.append(
                "the rollers form an O, seen from above, and the bridge drives an X: exchange the left and the right "
                "wheel of each axle"
            )
        return todo

    def finish(self, step: str, date: str, firmware: str) -> None:
        """Note that a step is done."""
        steps = (*self.table.steps, step)
        state: State = "rewire" if self.table.todo else "done" if set(STEPS) <= set(steps) else "begun"
        self.table = replace(self.table, steps=steps, date=date, firmware=firmware or None, state=state)

    def document(self) -> Mapping[str, object]:
        """Return the keys of the robot's file to write."""
        table = {f"commission.{name}": value or None for name, value in vars(self.table).items()}
        return {**self.values, **table}
