"""The services of simulation_interfaces and /clock, over a ``Simulation``."""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from simulation_interfaces.msg import Result, SimulationState, SimulatorFeatures
from simulation_interfaces.srv import (
    GetEntityState,
    GetSimulationState,
    GetSimulatorFeatures,
    ResetSimulation,
    SetEntityState,
    SetSimulationState,
    StepSimulation,
)

from hil.core.errors import HilError
from hil.core.types import Pose
from hil.service.ros2.convert import heading, quaternion
from hil.service.ros2.simulation import Simulation

ENTITY = "robot"
"""The name of the only entity."""

_FEATURES = (
    SimulatorFeatures.ENTITY_STATE_GETTING,
    SimulatorFeatures.ENTITY_STATE_SETTING,
    SimulatorFeatures.SIMULATION_RESET,
    SimulatorFeatures.SIMULATION_RESET_TIME,
    SimulatorFeatures.SIMULATION_RESET_STATE,
    SimulatorFeatures.SIMULATION_STATE_GETTING,
    SimulatorFeatures.SIMULATION_STATE_SETTING,
    SimulatorFeatures.SIMULATION_STATE_PAUSE,
    SimulatorFeatures.STEP_SIMULATION_SINGLE,
    SimulatorFeatures.STEP_SIMULATION_MULTIPLE,
)


class ClockPublisher:
    """Publishes the simulated time on ``clock``, as every simulator does: the newest only, none sent again."""

    def __init__(self, node: Any) -> None:
        self._message = Clock()
        self._to = node.create_publisher(Clock, "clock", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))

    def __call__(self, now_ns: int) -> None:
        """Publish a time [ns]."""
        stamp = self._message.clock
        stamp.sec, stamp.nanosec = divmod(now_ns, 1_000_000_000)
        self._to.publish(self._message)


class Simulator:
    """The services, below the node's own name. Each waits in a thread of its own, so that topics go on meanwhile."""

    def __init__(self, node: Any, simulation: Simulation, world: str) -> None:
        self._node = node
        self._simulation = simulation
        self._world = world
        self._is_stopped = False
        self._beside = ThreadPoolExecutor(1, "simulator")
        for kind, name, answer in (
            (GetSimulatorFeatures, "get_simulator_features", self._features),
            (GetSimulationState, "get_simulation_state", self._state),
            (SetSimulationState, "set_simulation_state", self._set_state),
            (StepSimulation, "step_simulation", self._step),
            (ResetSimulation, "reset_simulation", self._reset),
            (GetEntityState, "get_entity_state", self._entity),
            (SetEntityState, "set_entity_state", self._set_entity),
        ):
            node.create_service(kind, f"~/{name}", self._aside(answer))

    def close(self) -> None:
        """Answer no more."""
        self._beside.shutdown(wait=False, cancel_futures=True)

    def _aside(self, answer: Callable[[Any, Any], None]) -> Callable[[Any, Any], Any]:
        async def serve(request: Any, response: Any) -> Any:
            done = Future(executor=self._node.executor)

            def work() -> None:
                try:
                    answer(request, response)
                except HilError as error:
                    _fail(response, Result.RESULT_OPERATION_FAILED, str(error))
                finally:
                    done.set_result(None)

            self._beside.submit(work)
            await done
            return response

        return serve

    def _features(self, _: Any, response: Any) -> None:
        response.features.features = list(_FEATURES)
        response.features.custom_info = (
            "hil ros2: firmware and FMU in lockstep; one robot, which is there from the start"
        )

    def _state(self, _: Any, response: Any) -> None:
        playing = SimulationState.STATE_PAUSED if self._simulation.is_paused else SimulationState.STATE_PLAYING
        response.state.state = SimulationState.STATE_STOPPED if self._is_stopped else playing
        response.result.result = Result.RESULT_OK

    def _set_state(self, request: Any, response: Any) -> None:
        now = GetSimulationState.Response()
        self._state(None, now)
        wanted, present = request.state.state, now.state.state
        response.result.result = Result.RESULT_OK
        if wanted == present:
            _fail(response, SetSimulationState.Response.ALREADY_IN_TARGET_STATE, "it is so already")
        elif wanted == SimulationState.STATE_STOPPED:
            self._simulation.pause(paused=True)
            self._simulation.reset()
            self._is_stopped = True
        elif wanted in (SimulationState.STATE_PLAYING, SimulationState.STATE_PAUSED):
            self._is_stopped = False
            self._simulation.pause(paused=wanted == SimulationState.STATE_PAUSED)
        else:
            _fail(
                response, Result.RESULT_FEATURE_UNSUPPORTED, "expected stopped, playing or paused; end it by a signal"
            )

    def _step(self, request: Any, response: Any) -> None:
        if not self._simulation.is_paused:
            _fail(response, Result.RESULT_OPERATION_FAILED, "the simulation is not paused; pause it first")
            return
        self._is_stopped = False
        self._simulation.step(request.steps)
        response.result.result = Result.RESULT_OK

    def _reset(self, request: Any, response: Any) -> None:
        kinds = ResetSimulation.Request
        scope = request.scope or kinds.SCOPE_ALL
        if not scope & kinds.SCOPE_STATE:
            _fail(response, Result.RESULT_FEATURE_UNSUPPORTED, "time alone is not reset; use SCOPE_STATE or SCOPE_ALL")
            return
        self._simulation.reset(keep_time=not scope & kinds.SCOPE_TIME)
        response.result.result = Result.RESULT_OK

    def _entity(self, request: Any, response: Any) -> None:
        motion = self._simulation.truth
        if not _is_robot(request, response):
            return
        if motion is None or motion.truth is None:
            _fail(response, Result.RESULT_INCORRECT_STATE, "no tick was done yet; step or play the simulation")
            return
        state = response.state
        state.header.frame_id = self._world
        state.header.stamp.sec, state.header.stamp.nanosec = divmod(round(motion.time_unix_s * 1e9), 1_000_000_000)
        state.pose.position.x, state.pose.position.y = motion.truth[:2]
        state.pose.orientation.z, state.pose.orientation.w = quaternion(motion.truth[2])
        if motion.true_twist is not None:
            state.twist.linear.x, state.twist.linear.y, state.twist.angular.z = motion.true_twist
        response.result.result = Result.RESULT_OK

    def _set_entity(self, request: Any, response: Any) -> None:
        if not _is_robot(request, response):
            return
        state = request.state
        if request.set_twist or request.set_acceleration or not request.set_pose:
            _fail(response, Result.RESULT_FEATURE_UNSUPPORTED, "only a pose can be set; the robot is at rest there")
            return
        try:
            pose = Pose(state.pose.position.x, state.pose.position.y, heading(state.pose.orientation))
        except HilError as error:
            _fail(response, SetEntityState.Response.INVALID_POSE, str(error))
            return
        if not math.isfinite(sum(pose)):
            _fail(response, SetEntityState.Response.INVALID_POSE, f"pose {tuple(pose)}: expected finite numbers")
            return
        self._simulation.reset(pose, keep_time=True)
        response.result.result = Result.RESULT_OK


def _is_robot(request: Any, response: Any) -> bool:
    if request.entity == ENTITY:
        return True
    _fail(response, Result.RESULT_NOT_FOUND, f"entity {request.entity!r}: there is only {ENTITY!r}")
    return False


def _fail(response: Any, code: int, sentence: str) -> None:
    response.result.result, response.result.error_message = code, sentence
