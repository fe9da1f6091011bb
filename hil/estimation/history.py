"""The recent past of a filter, which is recomputed when a pose fix arrives late."""

from bisect import bisect_left, insort
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from hil.core.types import MeasuredPose
from hil.estimation.belief import Belief, Step, moved

Correct = Callable[[Belief, MeasuredPose], Belief]


@dataclass(slots=True)
class _Node:
    """The belief at a measurement, with the step that leads to it and the fixes within that step, in order."""

    belief: Belief
    step: Step | None
    fixes: list[MeasuredPose] = field(default_factory=list)


class History:
    """Beliefs at the measurements of the last ``length_ns``, in order.

    A fix is applied at its own instant, within the step that contains it. The result is exactly that of fixes without
    delay and in order. The cost is to recompute the steps since that instant, at most those of ``length_ns``.
    """

    def __init__(self, first: Belief, length_ns: int, correct: Correct) -> None:
        self._length_ns = length_ns
        self._correct = correct
        self._nodes = deque([_Node(first, None)])

    @property
    def newest(self) -> Belief:
        """The belief at the newest measurement."""
        return self._nodes[-1].belief

    @property
    def begin_ns(self) -> int:
        """Fixes must be later than this instant."""
        return self._nodes[0].belief.time_ns

    def append(self, step: Step, time_ns: int) -> None:
        """Add one step and drop steps older than ``length_ns``."""
        self._nodes.append(_Node(moved(self.newest, step, time_ns), step))
        while self._nodes[1].belief.time_ns <= time_ns - self._length_ns:
            self._nodes.popleft()

    def replace(self, steps: Sequence[Step]) -> None:
        """Put these steps in place of the newest, in order; those before the first node do not matter any more."""
        first = max(1, len(self._nodes) - len(steps))
        for index in range(first, len(self._nodes)):
            self._nodes[index].step = steps[index - len(self._nodes)]
            self._recompute(self._nodes[index - 1].belief, self._nodes[index])

    def insert(self, fixes: list[MeasuredPose]) -> int:
        """Apply fixes later than ``begin_ns`` and not later than the newest measurement, in any order.

        Returns the number of duplicates, which are not applied twice.
        """
        earliest, doubles = len(self._nodes), 0
        for fix in fixes:
            index = len(self._nodes) - 1
            while self._nodes[index - 1].belief.time_ns >= fix.time_ns:
                index -= 1
            held = self._nodes[index].fixes
            place = bisect_left(held, fix)
            if place < len(held) and held[place] == fix:
                doubles += 1
                continue
            # Ordered by all their numbers, so that fixes of one instant have a fixed order too.
            insort(held, fix)
            earliest = min(earliest, index)
        for index in range(earliest, len(self._nodes)):
            self._recompute(self._nodes[index - 1].belief, self._nodes[index])
        return doubles

    def _recompute(self, belief: Belief, node: _Node) -> None:
        assert node.step is not None, "the first node has no step, and no fix is before it"
        begin_ns, end_ns = belief.time_ns, node.belief.time_ns
        for fix in node.fixes:
            if fix.time_ns > belief.time_ns:
                share = (fix.time_ns - belief.time_ns) / (end_ns - begin_ns)
                belief = moved(belief, node.step, fix.time_ns, share)
            belief = self._correct(belief, fix)
        if end_ns > belief.time_ns:
            belief = moved(belief, node.step, end_ns, (end_ns - belief.time_ns) / (end_ns - begin_ns))
        node.belief = belief
