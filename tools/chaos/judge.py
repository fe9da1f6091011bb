"""Watches the robot's truth, and what its service says of it. What is wrong is a sentence."""

import contextlib
import threading
import time
from typing import Any

from firmware_protocol.generated.messages import State
from hil.core.errors import HilError
from hil.core.kinematics import BodyTwist
from hil.robot.truth_client import TruthClient
from hil.scenario import load
from tools.chaos.world import World

MOVES_M_S = 0.03
STOPS_S = 1.2
"""From the last valid command: a watchdog of at most 0.1 s, a ramp of 0.2 s, and the robot's own inertia."""
FRESH_MS = 150
LIES_S = 2.0
_POLL_S = 0.05
_STATES = {"active": State.ACTIVE, "fault": State.FAULT, "estop": State.ESTOP}
"""What the robot is, by what the service says of it."""


class Judge:
    """Watches until ``close``. ``trouble`` are the sentences; the others are counts of what it has seen."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._knows_states = world.kind.has_line  # only our firmware tells its state, and how old its command is
        scenario = load(world.kind.scenario, set=world.kind.sets)
        self._hash, self._radius_m = scenario.hash, scenario.robot.lever_m
        self.trouble: list[str] = []
        self.records = self.moved = self.statuses = 0
        self.is_moving = False
        self._state: State | None = None
        self.must_stand = False  # what nobody commands: the host is dead or stopped
        self.robot_sleeps = False  # the robot's process is stopped or killed: it says nothing
        self._ends = threading.Event()
        self._threads = [
            threading.Thread(target=watch, name=watch.__name__, daemon=True)
            for watch in (self._watch_truth, self._watch_status)
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Stop watching."""
        self._ends.set()
        for thread in self._threads:
            thread.join()

    def _say(self, sentence: str) -> None:
        if sentence not in self.trouble:
            self.trouble.append(sentence)

    def _watch_truth(self) -> None:
        while not self._ends.wait(_POLL_S):
            if not (url := self._world.truth):
                continue  # the robot is dead
            try:
                with contextlib.closing(TruthClient(url, self._hash, reset=False)) as truth:
                    self._watch(truth)
            except HilError as error:
                if url == self._world.truth:
                    self._say(f"the truth ended: {error}")
                    return
            self.is_moving, self._state = False, None

    def _watch(self, truth: TruthClient) -> None:
        """Watch one robot. Raises DeviceError when it has ended."""
        stands_since_s: float | None = None
        moves_since_ns: int | None = None
        while not self._ends.wait(0.02):
            truth.poll()
            for record in truth.taken:
                self.records += 1
                self._state = record.state
                twist = BodyTwist(*record.fix.twist)
                self.is_moving = max(abs(twist[0]), abs(twist[1]), abs(twist[2]) * self._radius_m) > MOVES_M_S
                self.moved += self.is_moving
                # By the robot's own clock: it moves although its firmware has no fresh command, or is not armed.
                is_fresh = record.state is State.ACTIVE and record.command_age_ms <= FRESH_MS
                if not self.is_moving or is_fresh or not self._knows_states:
                    moves_since_ns = None
                elif moves_since_ns is None:
                    moves_since_ns = record.fix.time_ns
                elif record.fix.time_ns - moves_since_ns > STOPS_S * 1e9:
                    self._say(
                        f"it moved for {STOPS_S:g} s in {record.state.name}, its newest command "
                        f"{record.command_age_ms} ms old"
                    )
            # By ours: it moves although nobody alive commands it.
            if not self.must_stand or self.robot_sleeps:
                stands_since_s = None
            elif stands_since_s is None:
                stands_since_s = time.monotonic()
            elif self.is_moving and time.monotonic() - stands_since_s > STOPS_S + 0.5:
                self._say("it moved though its host was dead or stopped")

    def _watch_status(self) -> None:
        """Compare the service's reports with the truth; a silent service is not a liar."""
        since_s, said = 0.0, ""
        while not self._ends.wait(_POLL_S):
            status = self.status()
            if status is None:
                said = ""
                continue
            self.statuses += 1
            lie = self._lie(status["phase"])
            if lie != said:
                since_s, said = time.monotonic(), lie
            elif lie and time.monotonic() - since_s > LIES_S:
                self._say(f"the service says {status['phase']} and the robot {lie}")

    def _lie(self, phase: str) -> str:
        """Return the robot's action that contradicts the service's report, or nothing."""
        state = self._state
        if self.robot_sleeps or state is None:
            return ""
        if phase == "disarmed" and self.is_moving:
            return "moves"
        if self._knows_states and (
            state is State.ACTIVE if phase == "disarmed" else state is not _STATES.get(phase, state)
        ):
            return f"is {state.name}"
        return ""

    def status(self) -> dict[str, Any] | None:
        """Return the service's status; None while it gives none."""
        client = self._world.client()
        if client is None:
            return None
        try:
            return client.status()
        except HilError:
            return None
