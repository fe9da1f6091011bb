"""A recorded run repeated by the whole controller: equal where nothing changed, else the part that differs first."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from typer import Exit

import hil
from firmware_protocol.client import Client
from firmware_protocol.codec import encode
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.addons.replay.recorded_robot import SentFrames
from hil.addons.replay.replay import part_of, replay
from hil.addons.replay.replay_command import replay as command
from hil.core.errors import BadInputError, OverdueError
from hil.core.guard import Guard
from hil.core.signals import SIGNAL_NAMES
from hil.estimation.estimators import OdometryEstimator
from hil.laws.surface import SurfaceLaw
from hil.record import journal
from hil.record.reader import read
from hil.references.shapes import Circle
from hil.scenario import load
from hil.wire.conditions import ConditionedLink
from tests.runtime.test_tick_watch import LOOP, law

NOT_COMPARED = {
    *("loop.tick", "loop.lateness_us", "loop.tick_us", "loop.deadline_misses"),
    *("link.sent", "link.received", "link.rejected", "link.load_percent"),
}
SHORT = {"loop.duration_s": 0.5, "expect": []}
ON_PATH = {"plant.start.start_x_m": 1.0, "plant.start.start_y_m": 0.0}  # no wheel is at its limit
ODOMETRY = {"estimator.source": "odometry"}
LATE = {"link.command_latency_s": 0.003, "link.feedback_latency_s": 0.002}
FAULTS = {
    "fault": [
        {"kind": "drop", "target": "feedback", "start_s": 0.1, "end_s": 0.2, "value": 0.3},
        {"kind": "jitter", "target": "command", "start_s": 0.1, "end_s": 0.4, "value": 0.004},
    ]
}
LOST = {
    "loop.duration_s": 1.6,
    "loop.rearm": True,
    "fault": [{"kind": "disconnect", "start_s": 0.3, "end_s": 0.5}],
}
RUNS = {
    "by torque in one process": ("paper_circle", {}),
    "by odometry": ("circle_speed", ODOMETRY),
    "fused": ("circle_speed", {"estimator.source": "fused"}),
    "latency": ("circle_speed", LATE),
    "faults of the link": ("circle_speed", FAULTS),
    "a link that is lost": ("circle_speed", LOST),
    "a bus": ("circle_speed", {"link.url": "can:virtual/replayed"}),
    "other motors": ("circle_speed", {"device.driver": "odrive"}),
    "in real time": ("circle_speed", {"loop.mode": "realtime", "estimator.source": "fused"}),
    "a pseudo-terminal": ("circle_speed", {"loop.mode": "realtime", "link.url": "serial:pty"}),
    "other motors in real time": ("circle_speed", {"loop.mode": "realtime", "device.driver": "odrive"}),
}


@pytest.fixture(autouse=True, scope="module")
def _short_pieces():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(journal, "_PIECE_BYTES", 1000)
        yield


def recorded(path, scenario, **keys):
    result = hil.run(scenario, set=SHORT | keys, record=path, lenient=True)
    assert result.failure is None
    return read(path, with_journal=True)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run whose pose comes from its wheels."""
    return recorded(tmp_path_factory.mktemp("replay") / "run.mcap", "circle_speed", **ODOMETRY, **ON_PATH)


@pytest.mark.parametrize("name", RUNS)
def test_an_unchanged_controller_does_the_same_again(name, tmp_path):
    scenario, keys = RUNS[name]
    path = tmp_path / ("run.rrd" if name == "latency" else "run.mcap")
    found = replay(recorded(path, scenario, **keys))
    assert (found.signals, found.first_frame, found.notes, found.part) == ([], None, [], None)
    assert found.is_equal
    assert found.ticks > 80
    assert found.frames > found.ticks


DEFECTS = {
    "feedback": (Client, "feedback", lambda old: lambda self: scaled_speeds(old(self))),
    "estimate": (OdometryEstimator, "update", lambda old: lambda *given: nudged(old(*given))),
    "reference": (Circle, "at", lambda old: lambda self, t_s: old(self, t_s + 1e-3)),
    "law": (SurfaceLaw, "update", lambda old: lambda *given: louder(old(*given))),
    "client": (Client, "command", lambda old: lambda self, speed, *rest: old(self, speed[::-1], *rest)),
}


def scaled_speeds(feedback):
    if feedback is None:
        return None
    speeds = feedback.speed_rad_s
    return feedback._replace(speed_rad_s=type(speeds)(speeds[0] * 1.0001, *speeds[1:]))


def nudged(state):
    return state._replace(pose=state.pose._replace(x_m=state.pose.x_m * 1.0001))


def louder(asked):
    speeds = asked.speed_rad_s
    return asked._replace(speed_rad_s=type(speeds)(*(1.02 * one for one in speeds)))


@pytest.mark.parametrize("part", DEFECTS)
def test_the_part_with_a_defect_is_named(part, run, monkeypatch):
    place, name, change = DEFECTS[part]
    monkeypatch.setattr(place, name, change(getattr(place, name)))
    found = replay(run)
    assert not found.is_equal
    assert found.part == part
    if found.signals:
        assert found.signals[0].tick <= 10
    if part != "feedback":  # the wire has less digits than the first differences of the wheels
        assert found.first_frame is not None


def test_a_guard_that_changes_is_told_from_the_law(run, monkeypatch):
    apply = Guard.apply
    monkeypatch.setattr(Guard, "apply", lambda self, command: (apply(self, command)[0], command.speed_rad_s[0] > 0.0))
    assert replay(run).part == "guard"


def test_of_a_change_the_first_tick_and_its_size_are_told(run, tmp_path):
    """The gain of 8.01 for 8: an error of the path times 0.01 is commanded more."""
    changed = load("circle_speed", set=SHORT | ODOMETRY | ON_PATH | {"controller.gains.k1_1_s": 8.01})
    found = replay(run, scenario=changed, record=tmp_path / "now.mcap")
    now = read(tmp_path / "now.mcap")
    for one in found.signals:
        old, new = run.signals[one.signal], now.signals[one.signal]
        apart = np.abs(new - old)
        assert one.tick == np.flatnonzero(~((new == old) | (np.isnan(new) & np.isnan(old))))[0]
        assert one.most == np.nanmax(apart)
        assert one.t_s == pytest.approx(one.tick * 0.005)
        assert (one.recorded, one.now) == (old[one.tick], new[one.tick])
    assert found.part == "law"
    assert found.open_s == next(one.t_s for one in found.signals if one.part == "command")
    assert found.frames_differ > 0


def test_what_may_differ_is_given_by_signal(run, monkeypatch):
    place, name, change = DEFECTS["estimate"]
    monkeypatch.setattr(place, name, change(getattr(place, name)))
    most = {one.signal: one.most for one in replay(run).signals}
    allowed = replay(run, tolerances={"pose.x_m": most["pose.x_m"]})
    assert [one.signal for one in allowed.signals] == [name for name in most if name != "pose.x_m"]
    assert [one.signal for one in replay(run, tolerances={"*": 1e9}).signals] == []


def test_the_recorded_speed_of_the_clock_does_not_matter(tmp_path, monkeypatch):
    """A run of half a second in real time is repeated without waiting for its clock."""
    run = recorded(tmp_path / "run.mcap", "circle_speed", **{"loop.mode": "realtime"})
    monkeypatch.setattr("time.sleep", None)  # who waits fails
    assert replay(run).is_equal


def test_a_recording_that_was_cut_is_repeated_up_to_there(run):
    found = replay(replace(run, journal=run.journal[:1]))
    assert found.notes[-1].endswith("ticks were not repeated: the recording ends here")
    assert 0 < found.ticks < 100
    assert found.is_equal


def test_a_missing_piece_is_told(tmp_path):
    run = recorded(tmp_path / "run.mcap", "circle_speed", **LATE)
    assert len(run.journal) > 3
    found = replay(replace(run, journal=run.journal[:2] + run.journal[3:]))
    assert "piece 2 of its journal is missing; the run was repeated up to there" in found.notes
    assert found.is_equal


def test_a_recording_without_frames_is_refused(tmp_path):
    run = recorded(tmp_path / "run.mcap", "circle_speed", **{"record.frames": False})
    with pytest.raises(BadInputError, match=r"does not hold what its controller was told, .* \(--law LAW\); record it"):
        replay(run)


def test_a_recording_of_another_mode_or_without_its_scenario_is_refused(run):
    with pytest.raises(BadInputError, match="is of mode lockstep, and the scenario of mode realtime; a replay has the"):
        replay(run, scenario=load("circle_speed", mode="realtime"))
    without = {key: text for key, text in run.properties.items() if key != "scenario"}
    with pytest.raises(BadInputError, match="does not hold the scenario of its run; give the scenario with --scenario"):
        replay(replace(run, properties=without))


def test_a_law_that_does_not_return_ends_the_replay(run, tmp_path):
    keys = {"controller.law": law(tmp_path, LOOP), "loop.tick_limit_s": 0.1}
    with pytest.raises(OverdueError, match="did not end within"):
        replay(run, scenario=load("circle_speed", set=SHORT | ODOMETRY | keys))


def test_a_lost_link_is_lost_again_at_the_same_tick(tmp_path, monkeypatch):
    """Also where the session no longer waits for its commands to be delivered."""
    run = recorded(tmp_path / "run.mcap", "circle_speed", **LOST)
    monkeypatch.setattr(ConditionedLink, "exchange", None)
    found = replay(run)
    assert found.is_equal
    assert [one["lost_s"] for one in found.result.metrics["recoveries"]] == [pytest.approx(0.3, abs=0.01)]


def test_every_signal_has_a_part():
    """A law's own signals are the law's; so every other needs a pattern."""
    others = [name for name in SIGNAL_NAMES if part_of(name) == "law" and not name.startswith("gain.")]
    assert others == [name for name in SIGNAL_NAMES if name in NOT_COMPARED or name.endswith("_bytes")]
    assert part_of("fuzzy.x.rule") == "law"


def test_the_command_prints_what_differs_and_exits_with_1(run, capsys, monkeypatch):
    command(run.path)
    assert re.fullmatch(rf"equal: 100 ticks, \d{{3}} frames are as in {run.path}\n", capsys.readouterr().out)
    place, name, change = DEFECTS["estimate"]
    monkeypatch.setattr(place, name, change(getattr(place, name)))
    with pytest.raises(Exit) as ended:
        command(run.path)
    assert ended.value.exit_code == 1
    text = capsys.readouterr().out
    assert text.startswith("different: estimate first; 100 ticks, ")
    assert "first frame: WHEEL_COMMAND (fl_rad_s " in text
    assert "part      signal" in text
    assert "the commands differ: the recorded robot followed the old ones, so what differs later shows" in text
    with pytest.raises(Exit):
        command(run.path, as_json=True)
    figures = json.loads(capsys.readouterr().out)
    assert (figures["equal"], figures["part"], figures["signals"][0]["signal"]) == (False, "estimate", "pose.x_m")
    assert figures["frames"]["first"]["text"] in text


@pytest.mark.parametrize("text", ["pose.x_m", "pose.x_m=", "=1", "pose.*=-1", "pose.*=nan", "pose.*=much"])
def test_a_tolerance_that_is_none_is_refused(text, run):
    with pytest.raises(BadInputError) as refused:
        command(run.path, tolerance=[text])
    assert str(refused.value) == (
        f"--tolerance {text}: expected SIGNAL=VALUE with a value of 0 or more, as in pose.*=1e-6"
    )


def test_a_law_alone_takes_no_option_of_the_whole(run, tmp_path):
    with pytest.raises(BadInputError, match="--law replays a law alone; give no other option"):
        command(run.path, law="dsc", record=tmp_path / "now.rrd")


def test_a_value_of_the_recorded_scenario_can_be_set(run, capsys):
    with pytest.raises(Exit):
        command(run.path, sets=["controller.gains.k1_1_s=8.01"])
    assert capsys.readouterr().out.startswith("different: law first; ")
    command(run.path, sets=["loop.tick_limit_s=9"])
    with pytest.raises(BadInputError, match=r"--set loop: expected key=value, such as robot\.mass_kg=24"):
        command(run.path, sets=["loop"])
    with pytest.raises(BadInputError, match=r"unknown key controller\.gain; did you mean 'controller\.gains'"):
        command(run.path, sets=["controller.gain=3"])
    with pytest.raises(BadInputError, match="--bisect records no replay; leave --record out"):
        command(run.path, bisect="a..b", record=run.path)


COMMAND = [encode(m.WheelCommand(*speeds, 1, 2)) for speeds in ((1.0,) * 4, (2.0,) * 4)]
BEAT = encode(m.HostHeartbeat(1, 2, 1, 0, 3))
MS = 1_000_000


def compared(slack_ns, recorded, sent, *, is_ours=True):
    """What is told of frames, each with its moment, which is 10 ms long."""
    frames = SentFrames(slack_ns, is_ours=is_ours)
    for moment, frame in [*recorded, (99, BEAT)]:
        frames.expect(moment, moment * 10 * MS, [frame])
    for moment, frame in sent:
        frames.sent(moment, moment * 10 * MS, frame)
    frames.pass_to(99)
    words = None if frames.first is None else frames.first.words
    return frames.equal, frames.differences, words


def test_frames_are_compared_by_moment_and_identifier():
    one, two = COMMAND
    same = [(1, one), (2, two)]
    assert compared(0, same, same) == (2, 0, None)
    assert compared(0, [(1, one), (1, BEAT)], [(1, BEAT), (1, one)]) == (2, 0, None)
    equal, differ, words = compared(0, [(1, one), (2, two)], [(1, one), (2, one)])
    assert (equal, differ) == (1, 1)
    assert words.startswith("WHEEL_COMMAND (fl_rad_s 1.0, ")
    assert " is sent now where WHEEL_COMMAND (fl_rad_s 2.0, " in words
    equal, differ, words = compared(0, [(1, one)], [(1, one), (1, one)])
    assert (equal, differ) == (1, 1)
    assert words.endswith(" is sent now, and was not recorded")
    equal, differ, words = compared(0, [(1, one), (2, two)], [(2, two)])
    assert (equal, differ) == (1, 1)
    assert words.endswith("was recorded, and is not sent now")


@pytest.mark.parametrize("later", [-4, 4])
def test_in_real_time_a_heartbeat_may_move_and_a_command_may_not(later):
    rest = (40, COMMAND[1])
    assert compared(50 * MS, [(10, BEAT), rest], [(10 + later, BEAT), rest]) == (2, 0, None)
    assert compared(0, [(10, BEAT), rest], [(10 + later, BEAT), rest])[:2] == (1, 2)
    assert compared(50 * MS, [(10, BEAT), rest], [(10 + 2 * later, BEAT), rest])[:2] == (1, 2)
    assert compared(50 * MS, [(10, COMMAND[0]), rest], [(10 + later, COMMAND[0]), rest])[:2] == (1, 2)


def test_frames_of_other_makers_are_told_as_bytes():
    """0x300 is STEP with us alone."""
    frame = Frame(0x300, b"\x01\x02")
    assert compared(0, [(1, frame)], [(1, frame)], is_ours=False) == (1, 0, None)
    assert compared(0, [(1, frame)], [], is_ours=False)[2].startswith("frame 0x300 with 0102 was recorded")
    assert compared(0, [(1, Frame(5, b""))], [], is_ours=False)[2].startswith("frame 0x005 with no data was")
