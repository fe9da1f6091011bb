"""The messages of a node, field by field, with a node that only takes note of what is published and said."""

import math
from types import SimpleNamespace as Values
from typing import Any

import pytest

from hil.addons.ros2.settings import Settings
from hil.addons.service.messages import Action, Motion
from hil.core.errors import DeviceError
from hil.scenario import load
from tests.support.ros2_testbed import needs_ros

pytestmark = needs_ros
UNKNOWN = dict.fromkeys(Motion.__dataclass_fields__)
POSES = {"pose": (1.0, -2.0, 0.5), "twist": (0.3, -0.4, 0.2)}
WHEELS = (1.0, -2.0, 3.0, 4.5)
SCENARIO = load("circle_speed")


class Node:
    """Takes note of all that is published and said; ``call`` has the callbacks by topic, ``timers`` those of time."""

    def __init__(self) -> None:
        self.sent: list[tuple[str, Any]] = []
        self.said: list[str] = []
        self.call: dict[str, Any] = {}
        self.timers: list[Any] = []
        self.now_ns = 0
        self.publishers: list[Any] = []

    def get_fully_qualified_name(self) -> str:
        return "/two/mecanum_hil"

    def get_logger(self) -> Any:
        return Values(warning=self.said.append)

    def get_clock(self) -> Any:
        return Values(now=lambda: Values(nanoseconds=self.now_ns))

    def create_publisher(self, kind: Any, topic: str, depth: int) -> Any:
        return Values(publish=lambda message: self.sent.append((topic, message)))

    def create_subscription(self, kind: Any, topic: str, call: Any, qos: Any) -> Any:
        self.call[topic] = call
        return Values(topic_name=f"/{topic}", msg_type=kind)

    def create_timer(self, period_s: float, call: Any, clock: Any) -> Any:
        timer = Values(period_s=period_s, call=call, runs=True)
        timer.cancel = lambda: setattr(timer, "runs", False)
        timer.reset = lambda: setattr(timer, "runs", True)
        self.timers.append(timer)
        return timer

    def get_publishers_info_by_topic(self, topic: str) -> Any:
        return [Values(topic_type=kind) for name, kind in self.publishers if name == topic]


class Robot:
    """Takes note of orders; ``refusal`` is its answer."""

    def __init__(self) -> None:
        self.orders: list[tuple[Action, Any]] = []
        self.refusal: str | None = None

    def order(self, action: Action, arguments: Any, answered: Any) -> None:
        self.orders.append((action, arguments))
        answered(self.refusal)


def publishers(node: Node, **settings: Any) -> Any:
    from hil.addons.ros2.topics import Publishers

    return Publishers(node, Settings(**settings))


def published(node: Node) -> dict[str, Any]:
    """Return what was published since the last call, by topic; each topic at most once."""
    found = dict(node.sent)
    assert len(found) == len(node.sent)
    node.sent.clear()
    return found


def stamp(message: Any) -> tuple[int, int]:
    return message.header.stamp.sec, message.header.stamp.nanosec


def odometry(message: Any) -> tuple[float, ...]:
    at, turned, twist = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist
    return (at.x, at.y, turned.z, turned.w, twist.linear.x, twist.linear.y, twist.angular.z)


def test_a_motion_is_published_field_by_field(monkeypatch: pytest.MonkeyPatch) -> None:
    """``tf2_msgs`` has no wheel: its place takes what its message has."""
    from hil.addons.ros2 import topics

    monkeypatch.setattr(topics, "TFMessage", lambda transforms: Values(transforms=transforms))
    node = Node()
    out = publishers(node, pose_sigma=(0.1, 0.2), twist_sigma=(0.3, 0.4), imu_frame_id="imu")
    known = POSES | {
        "truth": (1.5, -2.5, -0.5), "true_twist": (0.1, 0.2, 0.25), "angle_rad": (5.0, 6.0, 7.0, 8.0),
        "speed_rad_s": WHEELS, "torque_n_m": (0.1, 0.2, 0.3, 0.4), "sequence": 7, "yaw_rate_rad_s": 0.125,
        "acceleration_m_s2": (0.5, -0.25, 9.75),
    }  # fmt: skip
    out.motion(UNKNOWN | known | {"time_unix_s": 7.25})
    sent = published(node)
    cosine, sine = math.cos(0.5), math.sin(0.5)
    body = (0.3 * cosine - 0.4 * sine, -0.3 * sine - 0.4 * cosine)
    assert odometry(sent["odom"]) == pytest.approx((1.0, -2.0, math.sin(0.25), math.cos(0.25), *body, 0.2))
    body = (0.1 * cosine - 0.2 * sine, 0.1 * sine + 0.2 * cosine)
    true = (1.5, -2.5, math.sin(-0.25), math.cos(-0.25), *body, 0.25)
    assert odometry(sent["ground_truth/odom"]) == pytest.approx(true)
    (transform,) = sent["tf"].transforms
    place, turned = transform.transform.translation, transform.transform.rotation
    assert (place.x, place.y, turned.z, turned.w) == pytest.approx((1.0, -2.0, math.sin(0.25), math.cos(0.25)))
    for message in (sent["odom"], sent["ground_truth/odom"], transform):
        assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
    joints, imu = sent["joint_states"], sent["imu/data_raw"]
    assert joints.name == [f"{name}_wheel_joint" for name in ("front_left", "front_right", "rear_right", "rear_left")]
    assert (*joints.position, *joints.velocity, *joints.effort) == (5, 6, 7, 8, *WHEELS, 0.1, 0.2, 0.3, 0.4)
    acceleration = imu.linear_acceleration
    assert (imu.angular_velocity.z, acceleration.x, acceleration.y, acceleration.z) == (0.125, 0.5, -0.25, 9.75)
    assert (imu.header.frame_id, imu.orientation_covariance[0]) == ("imu", -1.0)
    assert list(imu.angular_velocity_covariance) == pytest.approx([0.0] * 8 + [1e-4])
    assert list(imu.linear_acceleration_covariance) == pytest.approx([0.01, 0, 0, 0, 0.01, 0, 0, 0, 0.01])
    assert sent["wheel_commands/applied"].data == 7
    for message in (sent["odom"], sent["ground_truth/odom"], transform, joints, imu):
        assert stamp(message) == (7, 250_000_000)

    def variances(part: Any) -> list[float]:
        return [part.covariance[place] for place in (0, 7, 35)]

    odom, truth = sent["odom"], sent["ground_truth/odom"]
    assert (variances(odom.pose), variances(odom.twist)) == (
        pytest.approx([0.01, 0.01, 0.04]),
        pytest.approx([0.09, 0.09, 0.16]),
    )
    assert variances(truth.pose) == variances(truth.twist) == [0.0, 0.0, 0.0]
    out.motion(UNKNOWN | POSES | {"time_unix_s": 7.5, "sigma": (0.5, 0.6)})
    sent = published(node)
    assert set(sent) == {"odom", "tf"}, "what is not known is not published"
    assert variances(sent["odom"].pose) == pytest.approx([0.25, 0.25, 0.36])


@pytest.mark.parametrize(
    ("known", "topics"),
    [
        ({"pose": (0.0, 0.0, 0.0)}, set()),
        ({"twist": (0.0, 0.0, 0.0)}, set()),
        ({"truth": (0.0, 0.0, 0.0)}, set()),
        ({"true_twist": (0.0, 0.0, 0.0)}, set()),
        ({"speed_rad_s": WHEELS}, {"joint_states"}),
        ({"angle_rad": WHEELS, "torque_n_m": WHEELS}, set()),
        ({"yaw_rate_rad_s": 0.0}, {"imu/data_raw"}),
        ({"acceleration_m_s2": (0.0, 0.0, 9.8)}, set()),
        ({"sequence": 0}, {"wheel_commands/applied"}),
        (POSES, {"odom"}),
    ],
)
def test_a_motion_of_which_little_is_known_is_published_as_far_as_it_is(known: Any, topics: set[str]) -> None:
    node = Node()
    publishers(node, enable_odom_tf=False).motion(UNKNOWN | known | {"time_unix_s": 1.0})
    assert set(published(node)) == topics


STATUS = {
    "time_unix_s": 100.5, "phase": "active", "why": None, "recording_trouble": None, "battery_v": 24.5, "task": None,
    "frames": {"sent": 10, "rejected": {"crc": 1}},
}  # fmt: skip


def test_a_status_is_published_once_a_second_and_at_each_change_of_phase() -> None:
    from diagnostic_msgs.msg import DiagnosticStatus

    node = Node()
    out = publishers(node)

    def told(**changes: Any) -> dict[str, Any]:
        out.status(STATUS | changes, {"dropped": 3})
        return published(node)

    sent = told()
    battery, (one,) = sent["battery_state"], sent["diagnostics"].status
    assert (stamp(battery), battery.voltage, battery.present) == ((100, 500_000_000), 24.5, True)
    assert math.isnan(battery.percentage)
    assert stamp(sent["diagnostics"]) == (100, 500_000_000)
    assert (one.name, one.level, one.message) == ("two/mecanum_hil: robot", DiagnosticStatus.OK, "active")
    values = {"time_unix_s": "100.5", "phase": "active", "battery_v": "24.5", "frames.sent": "10"}
    assert {each.key: each.value for each in one.values} == values | {"frames.rejected.crc": "1", "dropped": "3"}
    assert told(time_unix_s=101.49) == {}
    assert set(told(time_unix_s=101.5, battery_v=None)) == {"diagnostics"}
    levels = {
        ("disarmed", None, None): (DiagnosticStatus.OK, "disarmed"),
        ("active", "it is slow", None): (DiagnosticStatus.WARN, "it is slow"),
        ("arming", None, "disk full"): (DiagnosticStatus.WARN, "arming"),
        ("away", None, None): (DiagnosticStatus.ERROR, "away"),
        ("fault", "hot", None): (DiagnosticStatus.ERROR, "hot"),
        ("estop", None, None): (DiagnosticStatus.ERROR, "estop"),
    }
    for (phase, why, trouble), expected in levels.items():
        (one,) = told(time_unix_s=101.5, phase=phase, why=why, recording_trouble=trouble)["diagnostics"].status
        assert (one.level, one.message) == expected
    assert told(time_unix_s=101.5, phase="estop") == {}
    assert set(told(time_unix_s=5.0, phase="estop")) == {"battery_state", "diagnostics"}, "its clock was set back"
    out.lost("gone", 7, 8)
    message = published(node)["diagnostics"]
    assert (stamp(message), message.status[0].level) == ((7, 8), DiagnosticStatus.STALE)
    assert (message.status[0].message, message.status[0].values) == ("gone", [])
    assert set(told(time_unix_s=5.0, phase="estop")) == {"battery_state", "diagnostics"}, "at once when it is back"


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The time by which a node limits rates, as the test sets it."""
    from hil.addons.ros2 import topics

    clock = Values(now_s=100.0)
    monkeypatch.setattr(topics, "time", Values(monotonic=lambda: clock.now_s))
    return clock


def commands(node: Node, robot: Any, **settings: Any) -> Any:
    from hil.addons.ros2.topics import Commands

    return Commands(node, Settings(**settings), SCENARIO, robot)


def twist(x: float, y: float = 0.0, yaw: float = 0.0) -> Any:
    return Values(linear=Values(x=x, y=y, z=9.0), angular=Values(x=9.0, y=9.0, z=yaw))


def test_of_a_stream_of_twists_the_newest_is_sent_at_its_rate(clock: Any) -> None:
    node, robot = Node(), Robot()
    commands(node, robot, command_rate_hz=10.0)
    timer = node.timers[0]
    assert (timer.period_s, timer.runs) == (0.1, False)
    for at_s, x in ((100.0, 0.1), (100.05, 0.2), (100.08, 0.3)):
        clock.now_s = at_s
        node.call["cmd_vel"](twist(x, -0.5 * x, 0.25))
    assert timer.runs
    assert [arguments["vx_m_s"] for _, arguments in robot.orders] == [0.1]
    assert robot.orders[0] == (Action.TWIST, {"vx_m_s": 0.1, "vy_m_s": -0.05, "yaw_rate_rad_s": 0.25})
    clock.now_s = 100.1
    timer.call()
    timer.call()
    assert not timer.runs
    clock.now_s = 100.189
    node.call["cmd_vel"](twist(0.4))
    assert [arguments["vx_m_s"] for _, arguments in robot.orders] == [0.1, 0.3]
    clock.now_s = 100.191  # a little early is on time
    node.call["cmd_vel"](twist(0.35))
    timer.call()
    assert [arguments["vx_m_s"] for _, arguments in robot.orders] == [0.1, 0.3, 0.35]


def test_wheel_commands_are_scaled_to_the_robots_limit_and_counted(clock: Any) -> None:
    node, robot = Node(), Robot()
    taken = commands(node, robot)
    limit = SCENARIO.robot.speed_limit_rad_s
    node.call["wheel_commands"](Values(data=[2.0 * limit, -limit, 0.0, limit, 7.0]))
    values = [limit, -0.5 * limit, 0.0, 0.5 * limit]
    assert robot.orders == [(Action.WHEELS, {"command": "speed", "values": values, "sequence": 7})]
    node.call["wheel_commands"](Values(data=[1.0]))
    node.call["cmd_vel"](twist(math.inf))
    assert taken.figures == {"cmd_vel": 1, "wheel_commands": 2, "dropped": 2}
    assert [line.split(":")[0].split(";")[0] for line in node.said] == [
        "wheel_commands has 1 numbers",
        "cmd_vel has (inf, 0.0, 0.0)",
    ]


def test_a_reason_is_said_at_once_and_then_with_its_number_every_30_s(clock: Any) -> None:
    node, robot = Node(), Robot()
    taken = commands(node, robot)
    for at_s, why in ((0.0, "it is 5 m off"), (1.0, "it is 6 m off"), (29.9, "it is 7 m off"), (30.0, "it is 8 m off")):
        clock.now_s, robot.refusal = 100.0 + at_s, why
        node.call["cmd_vel"](twist(0.1))
    robot.refusal = "it is away"
    clock.now_s = 131.0
    node.call["cmd_vel"](twist(0.1))
    assert node.said == [
        "twist refused: it is 5 m off",
        "twist refused: it is 8 m off (2 more since this was said)",
        "twist refused: it is away",
    ]
    assert taken.figures["dropped"] == 5


def test_a_stamped_twist_that_is_old_is_dropped_and_one_without_a_stamp_is_new(clock: Any) -> None:
    node, robot = Node(), Robot()
    commands(node, robot, use_stamped_vel=True, command_timeout_s=0.2)
    node.now_ns = 50_300_000_000
    for sec, nanosec, x in ((50, 100_000_000, 0.1), (50, 99_000_000, 0.2), (0, 0, 0.3), (0, 1, 0.4), (51, 0, 0.45)):
        node.call["cmd_vel"](Values(header=Values(stamp=Values(sec=sec, nanosec=nanosec)), twist=twist(x)))
        clock.now_s += 1.0
    assert [arguments["vx_m_s"] for _, arguments in robot.orders] == [0.1, 0.3, 0.45]
    old = "cmd_vel is 0.201 s old, more than command_timeout_s = 0.2; it was dropped"
    assert node.said == [old], "the reason is the same whatever the number"


def test_a_publisher_of_another_type_is_told_once(clock: Any) -> None:
    node = Node()
    commands(node, Robot())
    look = node.timers[2].call
    node.publishers = [("/cmd_vel", "geometry_msgs/msg/Twist"), ("/wheel_commands", "std_msgs/msg/Float64MultiArray")]
    look()
    assert node.said == []
    node.publishers += [("/cmd_vel", "geometry_msgs/msg/TwistStamped"), ("/wheel_commands", "std_msgs/msg/Int64")]
    look()
    look()
    assert node.said == [
        "/cmd_vel: geometry_msgs/msg/TwistStamped is published, and geometry_msgs/msg/Twist is taken; see the "
        "parameter use_stamped_vel",
        "/wheel_commands: std_msgs/msg/Int64 is published, and std_msgs/msg/Float64MultiArray is taken",
    ]


def test_a_node_passes_on_what_the_robot_says_and_to_it_what_others_command(clock: Any) -> None:
    from hil.addons.ros2.node import RobotNode

    node, robot = Node(), Robot()
    services: list[str] = []
    heard: list[Any] = []
    robot.start = heard.append  # type: ignore[attr-defined]
    standing_in: Any = node
    standing_in.settings, standing_in._scenario = Settings(enable_odom_tf=False), SCENARIO
    standing_in.create_service = lambda _kind, name, _call: services.append(name)
    standing_in._serve, standing_in._hear = print, None
    standing_in.get_logger = lambda: Values(warning=lambda why, **_: node.said.append(why))
    RobotNode.use(standing_in, robot)  # type: ignore[arg-type]
    assert services == ["~/arm", "~/disarm", "~/estop", "~/clear", "~/stop"]
    assert heard == [None]
    node.call["cmd_vel"](twist(0.1))
    assert [action for action, _ in robot.orders] == [Action.TWIST]
    node.now_ns = 7_000_000_008
    hear = RobotNode._hear
    for message, topics in (
        ({"motion": UNKNOWN | POSES | {"time_unix_s": 7.5}}, {"odom"}),
        ({"status": STATUS}, {"battery_state", "diagnostics"}),
        ({"lost": "gone"}, {"diagnostics"}),
    ):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("rclpy.ok", lambda: True)
            hear(standing_in, message)
        sent = published(node)
        assert set(sent) == topics
    assert stamp(sent["diagnostics"]) == (7, 8)
    assert node.said == ["gone"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rclpy.ok", lambda: False)
        hear(standing_in, {"status": STATUS})
    assert published(node) == {}, "it is ending"


def test_a_served_robot_has_the_node_s_rate_and_fails_with_its_service(monkeypatch: pytest.MonkeyPatch) -> None:
    from hil.addons.ros2 import node

    made: list[Any] = []
    monkeypatch.setattr(node, "_run", lambda scenario, make, ros: made.append((scenario, make, ros)))
    asked_hz: list[float] = []
    live = Values(ask_for_motion=asked_hz.append)
    gone = DeviceError("it ended")
    node.run_served(SCENARIO, lambda: (Values(failure=lambda: gone), live), ["a"])
    ((scenario, make, ros),) = made
    assert (scenario, ros) == (SCENARIO, ["a"])
    robot = make(Values(settings=Settings(publish_rate_hz=40.0)))
    assert robot.failure() is gone
    robot._closing.set()
    robot._listen(live, lambda _: None)
    assert asked_hz == [40.0]


@pytest.mark.parametrize("ends", ["in order", "by a failure", "by Ctrl-C", "before it has a robot"])
def test_a_node_closes_its_robot_however_it_ends(ends: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from hil.addons.ros2 import node

    done: list[Any] = []
    oks = iter([True, True, False])
    failures = iter([None, DeviceError("it ended") if ends == "by a failure" else None])

    def spin_once(*, timeout_sec: float) -> None:
        done.append("spin")
        if ends == "by Ctrl-C":
            raise KeyboardInterrupt

    def make(made: Any) -> Any:
        if ends == "before it has a robot":
            raise DeviceError("none is there")
        return Values(failure=lambda: next(failures), close=lambda: done.append("close"))

    library = Values(
        init=lambda *, args, **_: done.append(args), ok=lambda: next(oks), try_shutdown=lambda: done.append("shutdown")
    )
    monkeypatch.setattr(node, "rclpy", library)
    monkeypatch.setattr(node, "signal", Values(signal=lambda *_: None, SIGINT=2, default_int_handler=None))
    monkeypatch.setattr(node, "RobotNode", lambda scenario: Values(use=lambda robot: done.append("use")))
    monkeypatch.setattr(node, "SingleThreadedExecutor", lambda: Values(add_node=lambda _: None, spin_once=spin_once))
    if ends in ("by a failure", "before it has a robot"):
        with pytest.raises(DeviceError, match=r"it ended|none is there"):
            node._run(SCENARIO, make, ["--ros-args"])
    else:
        node._run(SCENARIO, make, ["--ros-args"])
    within = {"by Ctrl-C": ["use", "spin", "close"], "before it has a robot": []}
    assert done == [["hil", "--ros-args"], *within.get(ends, ["use", "spin", "spin", "close"]), "shutdown"]
