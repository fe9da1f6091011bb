"""The recent past of the filter, which a late fix or a late finding of slip changes."""

from bisect import bisect_left, insort
from collections import deque
from collections.abc import Sequence

from hil.core.types import MeasuredPose, Pose
from hil.estimation.kalman import Belief, Model, corrected, moved, pose_after
from hil.estimation.motion_sums import MotionSums, Step

_LEG_NS = 100_000_000


class _Leg:
    """Steps of about 0.1 s with the fixes within them, in order, and the belief ``before`` them.

    ``parts`` are the sums of the motion up to each fix, and after the last one. ``fixed`` is the belief before the last
    part.
    """

    __slots__ = ("before", "due_ns", "ends_ns", "fixed", "fixes", "parts", "steps")

    def __init__(self, before: Belief) -> None:
        self.before = self.fixed = before
        self.due_ns = (before.time_ns // _LEG_NS + 1) * _LEG_NS
        self.steps: list[Step] = []
        self.ends_ns: list[int] = []
        self.fixes: list[MeasuredPose] = []
        self.parts = [MotionSums()]

    def append(self, step: Step, end_ns: int) -> None:
        self.steps.append(step)
        self.ends_ns.append(end_ns)
        self.parts[-1].add(step)

    def sum_again(self) -> None:
        """Make the parts anew, after a change of steps or fixes."""
        self.parts, at_ns, waiting = [MotionSums()], self.before.time_ns, deque(self.fixes)
        for step, end_ns in zip(self.steps, self.ends_ns, strict=True):
            begin_ns = at_ns
            while waiting and waiting[0].time_ns <= end_ns:
                to_ns = waiting.popleft().time_ns
                if to_ns > at_ns:
                    self.parts[-1].add(step, (to_ns - at_ns) / (end_ns - begin_ns))
                self.parts.append(MotionSums())
                at_ns = to_ns
            if end_ns > at_ns:
                self.parts[-1].add(step, (end_ns - at_ns) / (end_ns - begin_ns))
            at_ns = end_ns

    def end(self, model: Model) -> Belief:
        """Return the belief after the leg."""
        if self.ends_ns and self.ends_ns[-1] > self.fixed.time_ns:
            return moved(self.fixed, self.parts[-1], self.ends_ns[-1], model)
        return self.fixed

    def fix(self, model: Model) -> None:
        """Compute the belief after the last fix."""
        belief = self.before
        for fix, part in zip(self.fixes, self.parts, strict=False):
            if fix.time_ns > belief.time_ns:
                belief = moved(belief, part, fix.time_ns, model)
            belief = corrected(belief, fix, model)
        self.fixed = belief


class History:
    """The motion of the last ``length_ns``, in legs of 0.1 s, each with the belief before it.

    A fix is applied at its own instant, within the step that contains it. The result is exactly that of fixes without
    delay and in order. The cost is to repeat the legs since that instant, each with one product of small matrices: the
    sums of their motion depend on nothing that a fix changes.
    """

    def __init__(self, first: Belief, length_ns: int, model: Model) -> None:
        self._length_ns = length_ns
        self._model = model
        self._legs = deque([_Leg(first)])

    @property
    def known(self) -> Belief:
        """The belief at the last fix or the last begin of a leg, whichever is newer."""
        return self._legs[-1].fixed

    @property
    def pose(self) -> Pose:
        """The pose at the newest measurement."""
        leg = self._legs[-1]
        return pose_after(leg.fixed, leg.parts[-1])

    @property
    def newest(self) -> Belief:
        """The belief at the newest measurement."""
        return self._legs[-1].end(self._model)

    @property
    def begin_ns(self) -> int:
        """Fixes must be later than this instant."""
        return self._legs[0].before.time_ns

    def append(self, step: Step, time_ns: int) -> None:
        """Add one step, and drop legs that are older than ``length_ns``."""
        leg = self._legs[-1]
        if leg.ends_ns and leg.ends_ns[-1] >= leg.due_ns:
            leg = _Leg(leg.end(self._model))
            self._legs.append(leg)
            while len(self._legs) > 1 and self._legs[1].before.time_ns <= time_ns - self._length_ns:
                self._legs.popleft()
        leg.append(step, time_ns)

    def replace(self, steps: Sequence[Step]) -> None:
        """Put these steps in place of the newest, in order; those before the first leg do not matter any more."""
        rest, first = list(steps), len(self._legs)
        while rest and first > 0:
            first -= 1
            leg = self._legs[first]
            count = min(len(rest), len(leg.steps))
            if count:
                leg.steps[-count:] = rest[-count:]
                del rest[-count:]
                leg.sum_again()
        self._repeat(first)

    def insert(self, fixes: list[MeasuredPose]) -> int:
        """Apply fixes later than ``begin_ns`` and not later than the newest measurement, in any order.

        Returns the number of duplicates, which are not applied twice.
        """
        earliest, doubles = len(self._legs), 0
        for fix in fixes:
            index = len(self._legs) - 1
            while self._legs[index].before.time_ns >= fix.time_ns:
                index -= 1
            leg = self._legs[index]
            place = bisect_left(leg.fixes, fix)
            if place < len(leg.fixes) and leg.fixes[place] == fix:
                doubles += 1
                continue
            # Ordered by all their numbers, so that fixes of one instant have a fixed order too.
            insort(leg.fixes, fix)
            leg.sum_again()
            earliest = min(earliest, index)
        self._repeat(earliest)
        return doubles

    def _repeat(self, first: int) -> None:
        """Compute beliefs again, from this leg on."""
        for index in range(first, len(self._legs)):
            leg = self._legs[index]
            if index > first:
                leg.before = self._legs[index - 1].end(self._model)
            leg.fix(self._model)
