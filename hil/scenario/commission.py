"""``[commission]`` of a robot's file: how far `hil commission` has come with the robot, and what it found."""

from dataclasses import dataclass
from typing import Annotated, Literal

from hil.core.errors import BadInputError
from hil.core.options import Range
from hil.scenario.values import Text, Wheel

State = Literal["none", "begun", "rewire", "done"]
Way = Literal["forward", "backward"]


@dataclass(frozen=True)
class CommissionTable:
    """``[commission]``, written by `hil commission`. In the states "begun" and "rewire" real motors are refused."""

    state: Annotated[State, "none: never commissioned"] = "none"
    virtual: Annotated[bool, "whether a virtual robot answered, which says nothing of the real one"] = False
    steps: Annotated[tuple[Text, ...], "the steps that are done"] = ()
    date: Annotated[Text | None, "of the newest step"] = None
    firmware: Annotated[Text | None, "what answered then"] = None
    todo: Annotated[tuple[Text, ...], "what has to be changed at the robot before it may be driven"] = ()
    encoders: Annotated[tuple[int, ...], "for each motor output, from 1, the input of its encoder"] = ()
    encoder_signs: Annotated[tuple[int, ...], "-1 where the encoder counts against its motor"] = ()
    first_wheel: Annotated[Wheel | None, "the wheel of the first motor output, as a person saw it"] = None
    first_way: Annotated[Way | None, "how a positive torque turned it"] = None
    rollers: Annotated[Literal["x", "o"] | None, "how the wheels are mounted, as seen from above"] = None
    lateral_scale: Annotated[
        float | None, Range(gt=0), "true way to the left over that of the wheels; nothing uses it yet"
    ] = None


def require_commissioned(table: CommissionTable) -> str | None:
    """Return a warning for a real robot that was never commissioned, None for one that was.

    Raises BadInputError for one whose commissioning was begun and is not done.
    """
    if table.state == "none" or table.virtual:
        rehearsed = ", only a virtual one in its place" if table.virtual else ""
        return (
            f"nobody has commissioned this robot{rehearsed}: a wheel that is wired to another place, or the wrong way "
            "round, would drive it anywhere; `hil commission ROBOT` finds out how it is wired, or says who knows"
        )
    if table.state == "done":
        return None
    todo = f" ({'; '.join(table.todo)})" if table.todo else ""
    raise BadInputError(
        f'commission.state = "{table.state}": the commissioning of this robot is not done{todo}, and --allow-motion is '
        "refused until it is; go on with hil commission ROBOT"
    )
