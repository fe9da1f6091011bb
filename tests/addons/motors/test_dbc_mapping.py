"""What is wrong in a mapping or its DBC is refused when the settings are built, in a sentence with the way out."""

import re
import struct
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framing import Frame
from hil.addons.motors.dbc.dbc_driver import DIALECT
from hil.addons.motors.dbc.dbc_settings import Settings
from hil.core.errors import BadInputError
from hil.core.options import build
from hil.core.types import CommandMode
from hil.robot.driver import RobotFacts
from tests.support.dbc_mappings import EXAMPLES, edited_dbc, motors

ROBOT = RobotFacts(0.075, 0.6, (0, 1, 2, 3), (1, 1, 1, 1), 5.0, 60.0, 1.25, 0.1, 0.005, CommandMode.SPEED)
KEY, SPEED = "device.motors", "command.speed"


def settings_of(name: str, changes: Mapping[str, Any] | None = None) -> Settings:
    return build(Settings, motors(name, changes), "device.motors")


def refusal(changes: Mapping[str, Any], name: str = "wheel_drives") -> str:
    with pytest.raises(BadInputError) as refused:
        settings_of(name, changes)
    message = str(refused.value)
    assert "\n" not in message
    return message


WRONG = [
    (f"{SPEED}.fl", "DRIVE_FL.TargetSpeet", "command.speed.fl = 'DRIVE_FL.TargetSpeet': the message DRIVE_FL of "
     "wheel_drives.dbc has no signal 'TargetSpeet'; did you mean 'TargetSpeed'?"),
    (f"{SPEED}.fl", "DRIV_FL.TargetSpeed", "wheel_drives.dbc has no message 'DRIV_FL'; did you mean 'DRIVE_FL'?"),
    (f"{SPEED}.fl", "TargetSpeed", 'expected a signal of the DBC as text, such as "DRIVE_FL.TargetSpeed"'),
    (f"{SPEED}.fl", 7, "command.speed.fl = 7: expected a signal of the DBC as text"),
    (f"{SPEED}.rl", None, "command.speed: rl missing; name a signal for each of fl, fr, rr, rl"),
    (f"{SPEED}.fl", "DRIVE_FR.TargetSpeed", "command.speed: DRIVE_FR.TargetSpeed is named twice; each has a signal "
     "of its own"),
    (f"{SPEED}.lf", "DRIVE_FL.TargetSpeed", "command.speed.lf: unknown; did you mean 'fl'?"),
    (f"{SPEED}.unit", "rmp", "the unit 'rmp' is not known for a speed; did you mean 'rpm'?"),
    (f"{SPEED}.unit", 3, "unit = 3: expected text"),
    (f"{SPEED}.scale", 0, "command.speed.scale = 0: expected a number, more than zero"),
    (f"{SPEED}.scale", True, "command.speed.scale = True: expected a number"),
    (SPEED, "DRIVE_FL.TargetSpeed", 'command.speed = "DRIVE_FL.TargetSpeed"; expected a table'),
    (SPEED, None, "command has none: expected one of speed, torque and twist"),
    ("command.torque", {wheel: f"DRIVE_{wheel.upper()}.Feedforward" for wheel in ("fl", "fr", "rr", "rl")},
     "command has speed and torque: expected one of"),
    ("command.velocity", {}, "command.velocity: unknown"),
    ("feedback.speed", None, "feedback has neither: expected speed or twist"),
    ("feedback.position.scale", None, "the DBC gives it no unit; known: rad, "),
    ("feedback.position.wraps_at", -1, "feedback.position.wraps_at = -1: expected a number, more than zero"),
    ("feedback.speed.wraps_at", 1, "feedback.speed.wraps_at: unknown"),
    ("feedback.battery_voltage", "DRIVES_INFO.BatteryCurrent", "the unit 'A' is not known for a voltage"),
    ("feedback.rate_hz", 0, "feedback.rate_hz = 0: expected a number, more than zero"),
    ("feedback.speed.fl", "DRIVE_FL.TargetSpeed", "the message DRIVE_FL is sent by one table and received by another"),
    ("constants.DRIVE_FL.Mode", "sped", "constants.DRIVE_FL.Mode = 'sped': no value of this signal has this text; did "
     "you mean 'speed'?"),
    ("constants.DRIVE_FL.Mode", 3, "outside the signal's limits, 0 to 2"),
    ("constants.DRIVE_FL.Mode", float("nan"), "expected a finite number or a text"),
    ("constants.DRIVE_FL.Mode", 10**400, "expected a finite number or a text"),
    ("constants.DRIVE_FL.Mode", [1, 2], "constants.DRIVE_FL.Mode: expected one value"),
    ("constants.DRIVE_FL.Enable", "on", "its DBC has no value table for it, give a number"),
    ("constants.DRIVE_FL.Enable", 0.5, "constants.DRIVE_FL.Enable = 0.5: the signal has steps of 1; the nearest is 0"),
    ("constants.DRIVE_FL.TargetSpeed", 0, "constants: DRIVE_FL.TargetSpeed is already used in command"),
    ("constants.DRIVE_FL", 1, "constants.DRIVE_FL = 1; expected a table"),
    ("constants.STATUS_FL.State", 1, "constants.STATUS_FL: STATUS_FL is never sent"),
    ("counters", ["DRIVE_FL.Enable", "DRIVE_FL.Enable"], "counters: DRIVE_FL.Enable is already used in counters"),
    ("counters", "DRIVE_FL.Alive", "expected an array, each item text"),
    ("counters", ["DRIVE_FL.Alife"], "counters: 'DRIVE_FL.Alife': the message DRIVE_FL"),
    ("constants.DRIVE_FL.Alive", 3, "constants: DRIVE_FL.Alive is already used in counters"),
    ("enable.DRIVES_CONTROL.State", [], "expected at least one value"),
    *((f"{table}.NO_SUCH_MESSAGE", {}, f"device.motors: {table}.NO_SUCH_MESSAGE: wheel_drives.dbc has no message")
      for table in ("ask", "enable", "disable", "estop", "clear", "constants", "armed_when", "identity")),
    *((f"{table}.DRIVES_CONTROL", {}, f"{table}.DRIVES_CONTROL: names no signal; give at least one of State, Timeout")
      for table in ("ask", "enable", "disable", "estop", "clear", "constants")),
    ("armed_when.DRIVES_INFO", {}, "armed_when.DRIVES_INFO: names no signal; give at least one of Protocol"),
    ("errors.fl", [], "errors.fl = []: expected a signal, or an array of them"),
    ("errors.none", [], "errors.none = [] for STATUS_FL.Error: expected at least one value"),
    ("errors", {"none": 0}, "errors.none: no signal of errors is named; give one for fl, fr, rr, rl or robot"),
    ("enable.DRIVES_CONTROL.State", ["ready", "runn"], "did you mean 'run'?"),
    ("enable.DRIVES_CONTROL.Timeout", 5, "enable: DRIVES_CONTROL.Timeout is already used in watchdog.set"),
    ("enable.DRIVE_FL.Mode", ["off", "torque", "speed"], "enable.DRIVE_FL.Mode: 3 values, but "
     "enable.DRIVES_CONTROL.State has 2; each is one step, give as many to each"),
    ("armed_when.STATUS_FL.Stat", "run", "has no signal 'Stat'; did you mean 'State'?"),
    ("estop", {}, "estop_latches = true: nothing is sent for an e-stop"),
    ("identity.DRIVES_INFO.Protocol", [2, 256], "outside the signal's limits, 0 to 255"),
    ("errors.front", "STATUS_FL.Error", "errors.front: unknown"),
    ("errors.fl", 5, "errors.fl = 5: expected a signal of the DBC"),
    ("errors.none", "fine", "errors.none = 'fine' for STATUS_FL.Error: no value of this signal has this text"),
    ("watchdog.read", None, "watchdog.read is missing: a watchdog is set and read back"),
    ("watchdog.timeout_s", 0.1, "watchdog: give timeout_s, where it is fixed, or set and read"),
    ("watchdog.read", "DRIVES_INFO.BatteryVoltage", "the unit 'V' is not known for a time"),
    ("gear_ratio", 0.0, "gear_ratio = 0.0; expected a number greater than 0"),
    ("file", "nowhere.dbc", "file = 'nowhere.dbc': there is no such file"),
    ("file", str(EXAMPLES), "cannot be read"),
    ("file", __file__, "is no DBC that can be read"),
    ("file", "zero\0byte", "cannot be read"),
    ("fil", "x", "unknown key device.motors.fil; did you mean 'device.motors.file'?"),
]  # fmt: skip


@pytest.mark.parametrize(("key", "value", "sentence"), WRONG, ids=[f"{key}={value!r}"[:40] for key, value, _ in WRONG])
def test_a_mistake_in_the_mapping_is_refused(key: str, value: object, sentence: str) -> None:
    message = refusal({key: value})
    assert message.removeprefix("unknown key ").startswith("device.motors")
    assert sentence in message


def test_what_contradicts_itself_is_refused() -> None:
    assert "give unit or scale, not both" in refusal({f"{SPEED}.unit": "rpm", f"{SPEED}.scale": 2.0})
    wheels = {wheel: f"DRIVE_{wheel.upper()}.TargetSpeed" for wheel in ("fl", "fr", "rr", "rl")}
    message = refusal({SPEED: None, "command.torque": wheels | {"scale": 0.01}})
    assert message.endswith("command.feedforward: torques are added to speeds, and the command is torque")


def test_what_is_not_known_of_the_controllers_is_warned_of() -> None:
    driver = DIALECT.make(settings_of("wheel_drives", {"armed_when": None, "command.feedforward": None}), ROBOT)
    assert "device.motors.armed_when is empty: whether the controllers follow commands is not known" in driver.warnings
    assert (
        f"{KEY}.command without feedforward takes no torque beside a speed: the torques that a law gives ahead of the "
        "motion are dropped, and the wheels follow by their speed loops alone"
    ) in driver.warnings


def test_a_rate_is_asked_for_where_the_dbc_has_no_cycle_times() -> None:
    assert "feedback.rate_hz is missing: twist_base.dbc has no cycle time" in refusal(
        {"feedback.rate_hz": None}, "twist_base"
    )


def keys(table: Mapping[str, Any], path: str = "") -> list[str]:
    found = []
    for name, value in table.items():
        found += [path + name, *(keys(value, f"{path}{name}.") if isinstance(value, Mapping) else ())]
    return found


@given(st.data())
def test_no_value_of_any_kind_ends_in_a_traceback(data: st.DataObject) -> None:
    scalars = st.one_of(st.integers(), st.floats(), st.booleans(), st.text(max_size=5), st.just("STATUS_FL.Speed"))
    some = st.one_of(scalars, st.lists(scalars, max_size=3), st.dictionaries(st.text(max_size=3), scalars, max_size=2))
    name = data.draw(st.sampled_from(["wheel_drives", "twist_base"]))
    changes = {data.draw(st.sampled_from(keys(motors(name)))): data.draw(some)}
    with suppress(BadInputError):
        DIALECT.make(settings_of(name, changes), ROBOT._replace(speed_limit_rad_s=40.0))


CHANGED = [
    ("BO_ 272 DRIVE_FL: 8 HOST", "BO_ 272 DRIVE_FL: 64 HOST", "has 64 bytes and is for CAN FD"),
    (
        ' SG_ Mode : 1|3@1+ (1,0) [0|2] "" DRIVES\n SG_ Alive : 4|4@1+ (1,0) [0|15] "" DRIVES\n'
        " SG_ TargetSpeed : 8|16@1- ",
        ' SG_ Mode M : 1|3@1+ (1,0) [0|2] "" DRIVES\n SG_ Alive : 4|4@1+ (1,0) [0|15] "" DRIVES\n'
        " SG_ TargetSpeed m2 : 8|16@1- ",
        "is multiplexed",
    ),
    (
        "SG_ TargetSpeed : 8|16@1- (0.5,0)",
        "SG_ TargetSpeed : 8|16@1- (0,0)",
        "has in TargetSpeed a factor or an offset that is no number",
    ),
    (
        "SG_ TargetSpeed : 8|16@1-",
        "SG_ TargetSpeed : 60|16@1-",
        "DRIVE_FL of wheel_drives.dbc cannot be coded: The signal TargetSpeed does not fit in message DRIVE_FL.",
    ),
    ("SG_ TargetSpeed : 8|16@1-", "SG_ TargetSpeed : 0|16@1-", "overlapping"),
    ("VAL_ 256", "SIG_VALTYPE_ 288 Current : 1;\nVAL_ 256", "has in Current a float of 12 bits"),
    (
        "SG_ Alive : 4|4@1+ (1,0) [0|15]",
        "SG_ Alive : 4|4@1+ (1,0) [7|7]",
        "counters: 'DRIVE_FL.Alive': a counter is a whole number that has more than one value",
    ),
    ("BO_ 288 5;", "BO_ 288 -5;", "has a cycle time (GenMsgCycleTime) of -5; expected milliseconds"),
    ("BO_ 288 5;", "BO_ 288 99999999999;", "has a cycle time (GenMsgCycleTime) of 99999999999"),
    ('INT 0 10000;\nBA_DEF_DEF_ "GenMsgCycleTime" 0', 'ENUM "a","b";\nBA_DEF_DEF_ "GenMsgCycleTime" "a"', "of 'a'"),
    (
        "BO_ 256 DRIVES_CONTROL",
        'BO_ 700 STATUS_FL: 8 DRIVES\n SG_ Speed : 0|16@1- (1,0) [0|0] "rpm" HOST\n\nBO_ 256 DRIVES_CONTROL',
        "wheel_drives.dbc has 'STATUS_FL' 2 times, 0x2bc and 0x120; rename one",
    ),
]


@pytest.mark.parametrize(("old", "new", "sentence"), CHANGED, ids=[sentence for _, _, sentence in CHANGED])
def test_a_dbc_that_cannot_be_driven_by_is_refused(old: str, new: str, sentence: str, tmp_path: Path) -> None:
    assert sentence in refusal({"file": edited_dbc(tmp_path, "wheel_drives", (old, new))})


def test_limits_beyond_all_numbers_are_no_limits(tmp_path: Path) -> None:
    file = edited_dbc(tmp_path, "wheel_drives", ("(0.5,0) [-16000|16000]", "(0.5,0) [-1e308|1e308]"))
    assert not settings_of("wheel_drives", {"file": file}).plan.measured[0].has_limits


def test_a_flaw_in_a_message_that_nobody_uses_is_no_matter(tmp_path: Path) -> None:
    flaw = 'BO_ 7 OTHER: 8 HOST\n SG_ A : 0|8@1+ (0,0) [0|0] "" DRIVES\n SG_ B : 4|8@1+ (1,0) [0|0] "" DRIVES\n\n'
    file = edited_dbc(tmp_path, "wheel_drives", ("BO_ 272 DRIVE_FL", f"{flaw}BO_ 272 DRIVE_FL"))
    assert settings_of("wheel_drives", {"file": file}).plan.feedback_hz == 200.0
    assert "has in A a factor" in refusal({"file": file, "armed_when.OTHER.B": 1})


BARE = ("BO_ 256 DRIVES_CONTROL", "BO_ 2 STOP: 0 HOST\n\nBO_ 256 DRIVES_CONTROL")


@pytest.mark.parametrize("table", ["constants", "armed_when", "identity"])
def test_a_message_without_signals_is_no_constant_and_no_condition(table: str, tmp_path: Path) -> None:
    file = edited_dbc(tmp_path, "wheel_drives", BARE)
    assert f"{table}.STOP: it has no signals" in refusal({"file": file, table: {"STOP": {}}})


def test_a_gear_that_no_signal_is_behind_is_refused() -> None:
    assert "gear_ratio = 20: it would change nothing" in refusal({"gear_ratio": 20.0}, "twist_base")


# Fields of a signal that no table names


@given(
    st.sampled_from([(1.0, 0.0), (0.1, -3276.8), (0.5, -125.0), (-0.25, 64.0), (0.3, -1.0), (1.0, 40.0)]),
    st.one_of(st.none(), st.tuples(st.integers(-400, 400), st.integers(0, 400))),
    st.one_of(st.none(), st.integers(0, 65535)),
)
def test_a_field_that_no_table_names_is_sent_as_start_value_or_zero_or_is_refused(
    damaged: Path, conversion: tuple[float, float], limits: tuple[int, int] | None, start: int | None
) -> None:
    """The oracle is cantools, which decodes the sent frame."""
    low, size = limits or (0, 0)
    given = f'BA_DEF_ SG_ "GenSigStartValue" INT 0 65535;\nBA_ "GenSigStartValue" SG_ 272 Extra {start};\n'
    factor, offset = conversion
    file = edited_dbc(
        damaged.parent,
        "wheel_drives",
        (' SG_ Feedforward : 24|16@1- (0.001,0) [-20|20] "Nm" DRIVES\n\nBO_ 273',
         f' SG_ Extra : 24|16@1+ ({factor},{offset}) [{low}|{low + size}] "%" DRIVES\n\nBO_ 273'),
        ("VAL_ 256", (given if start is not None else "") + "VAL_ 256"),
    )  # fmt: skip
    settings = settings_of("wheel_drives", {"file": file, "command.feedforward": None})
    codec = cantools.database.load_file(file).get_message_by_name("DRIVE_FL")
    assert isinstance(codec, cantools.database.Message)
    least, most = sorted((offset, offset + 65535 * factor))
    is_limited = limits not in (None, (0, 0)) and low <= most and low + size >= least  # limits beyond the bits are none
    zero = -offset / factor
    has_zero = zero == round(zero) and 0 <= zero <= 65535 and (not is_limited or low <= 0 <= low + size)
    if start is None and not has_zero:
        with pytest.raises(BadInputError, match=r"constants.DRIVE_FL.Extra is missing: no table names this signal"):
            DIALECT.make(settings, ROBOT)
        return
    frames = DIALECT.make(settings, ROBOT).disarm()
    [payload] = [frame.payload for frame in frames if frame.id == 272]
    sent = codec.decode(payload, decode_choices=False)
    assert isinstance(sent, dict)
    assert sent["Extra"] == pytest.approx(0.0 if start is None else factor * start + offset, abs=1e-9)


def test_a_constant_is_what_is_asked_for(tmp_path: Path) -> None:
    edit = ('Timeout : 8|12@1+ (1,0) [0|2000] "ms" DRIVES', 'Timeout : 8|12@1+ (1,0) [10|2000] "ms" DRIVES')
    changes = {"file": edited_dbc(tmp_path, "wheel_drives", edit), "watchdog": None}
    assert refused_robot(ROBOT, changes=changes) == (
        "device.motors.constants.DRIVES_CONTROL.Timeout is missing: no table names this signal of a message that is "
        "sent, its DBC has no start value, and 0 is none of its values (10 to 2000 ms); give the value that it shall "
        "have in every frame"
    )
    frames = DIALECT.make(
        settings_of("wheel_drives", changes | {"constants.DRIVES_CONTROL.Timeout": 70}), ROBOT
    ).estop()
    assert [frame.payload.hex() for frame in frames] == ["03460000"]


# Texts and numbers


def test_a_text_of_two_numbers_is_met_by_both_and_sent_as_neither(tmp_path: Path) -> None:
    edits = [
        (f'VAL_ {n} State 0 "off" 1 "ready" 2 "run"', f'VAL_ {n} State 0 "off" 1 "run" 2 "run"') for n in (256, 288)
    ]
    file = edited_dbc(tmp_path, "wheel_drives", *edits)
    changes = {"file": file, "enable.DRIVES_CONTROL.State": 2}
    [condition, *_] = settings_of("wheel_drives", changes).plan.armed_when
    assert condition.raws == {1, 2}
    assert "enable.DRIVES_CONTROL.State = 'run': this text stands for 1 and 2; give one of these numbers" in refusal(
        changes | {"enable.DRIVES_CONTROL.State": "run"}
    )


def test_a_condition_of_a_float_is_met_by_the_number_that_its_bits_hold(tmp_path: Path) -> None:
    file = edited_dbc(
        tmp_path,
        "wheel_drives",
        (' SG_ BatteryVoltage : 24|16@1+ (0.01,0) [0|100] "V" HOST\n', ""),
        (
            ' SG_ BatteryCurrent : 40|16@1- (0.01,0) [-200|200] "A" HOST\n',
            ' SG_ Share : 32|32@1- (1,0) [0|1] "" HOST\n',
        ),
        ("VAL_ 256", "SIG_VALTYPE_ 304 Share : 1;\nVAL_ 256"),
    )
    changes = {"file": file, "feedback.battery_voltage": None, "feedback.battery_current": None}
    settings = settings_of("wheel_drives", changes | {"identity": {"DRIVES_INFO": {"Share": 0.1}}})
    driver = DIALECT.make(settings, ROBOT)
    for number in (288, 289, 290, 291):
        driver.feed(Frame(number, bytes(8)), 0)
    driver.feed(Frame(304, struct.pack("<4xf", 0.1)), 0)
    assert driver.identity == "controllers of wheel_drives.dbc with DRIVES_INFO.Share 0.1"


def test_two_messages_of_one_identifier_are_not_told_apart(tmp_path: Path) -> None:
    file = edited_dbc(tmp_path, "twist_base", ("BO_ 2566849280", "BO_ 2566849024"))
    assert "BASE_MOTION and BASE_IMU of twist_base.dbc have the same identifier" in refusal(
        {"file": file}, "twist_base"
    )


@pytest.fixture(scope="module")
def damaged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("dbc") / "twist_base.dbc"


@given(st.data())
def test_a_damaged_dbc_is_refused_or_read_but_never_a_traceback(damaged: Path, data: st.DataObject) -> None:
    text = (EXAMPLES / "twist_base.dbc").read_text("utf-8")
    for _ in range(data.draw(st.integers(1, 3))):
        begin, end = data.draw(st.sampled_from([found.span() for found in re.finditer(r"[\d.]+|\w+|\W", text)]))
        numbers = st.sampled_from(["0", "1", "-1", "7", "8", "16", "32", "64", "255", "1e999", "nan", "99999999999"])
        others = st.sampled_from(["", "|", "m0 ", " M ", '"', "\0", "@1-", "\n"])
        text = text[:begin] + data.draw(numbers if text[begin:end][0].isdecimal() else others) + text[end:]
    damaged.write_bytes(text.encode())
    try:
        settings = settings_of("twist_base", {"file": str(damaged)})
        driver = DIALECT.make(settings, ROBOT._replace(speed_limit_rad_s=40.0))
    except BadInputError:
        return
    for frame in (*driver.command((1.0, -2.0, 3.0, 4.0), (0.0, 0.0, 0.0, 0.0), 0), *driver.disarm()):
        assert len(frame.payload) <= 8
    for message in settings.plan.received.values():
        driver.feed(Frame(message.id, data.draw(st.binary(max_size=8))), 0)
    assert driver.sample is None or len(driver.sample.speed_rad_s) == 4


def test_a_file_of_any_length_is_no_wait_for_ever(tmp_path: Path) -> None:
    """cantools reads a megabyte a second, and /dev/zero never ends."""
    file = tmp_path / "huge.dbc"
    with file.open("wb") as opened:
        opened.truncate(32_000_001)
    for name in (str(file), *(["/dev/zero"] if Path("/dev/zero").exists() else [])):
        assert "has more than 32 MB, which takes long to read; give one that has only the" in refusal({"file": name})


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            "BO_ 2566848768 ",
            "BO_ 419365120 ",
            "more than 11 bits .*; a DBC has 2147483648 added to an identifier of 29",
        ),
        (
            "VERSION",
            'VAL_ 7 Nothing 0 "off" ;\nVERSION',
            "unused VAL_ entries in DBC: VAL_ 7 Nothing.*; remove these lines",
        ),
    ],
)
def test_what_cantools_refuses_has_a_remedy(old: str, new: str, sentence: str, tmp_path: Path) -> None:
    assert re.search(sentence, refusal({"file": edited_dbc(tmp_path, "twist_base", (old, new))}, "twist_base"))


def test_cantools_is_asked_for_when_it_is_not_there(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "cantools", None)
    message = refusal({"file": edited_dbc(tmp_path, "wheel_drives")})
    assert message.endswith("pip install 'mecanum-hil[dbc]'")


def refused_robot(robot: RobotFacts, name: str = "wheel_drives", changes: Mapping[str, Any] | None = None) -> str:
    with pytest.raises(BadInputError) as refused:
        DIALECT.make(settings_of(name, changes), robot)
    return str(refused.value)


def test_a_robot_faster_than_a_signal_is_refused(tmp_path: Path) -> None:
    assert refused_robot(ROBOT._replace(speed_limit_rad_s=64.0)) == (
        "device.motors.command: DRIVE_FL.TargetSpeed goes from -62.83 to 62.83 rad/s of the wheel, and "
        "robot.speed_limit_rad_s asks for 64 both ways; lower that, or correct unit, scale or gear_ratio"
    )
    assert "BASE_COMMAND.Forward goes from -3 to 3 m/s" in refused_robot(ROBOT, "twist_base")
    for limits, words in (("[0|12000]", "from 0 to 62.83"), ("[-12000|0]", "from -62.83 to 0")):
        file = edited_dbc(tmp_path, "wheel_drives", ("[-12000|12000]", limits))
        assert f"{words} rad/s of the wheel, and robot" in refused_robot(ROBOT, changes={"file": file})
    assert "firmware.torque_limit_n_m asks for 401 both ways" in refused_robot(ROBOT._replace(torque_limit_n_m=401.0))


def test_a_watchdog_longer_than_its_signal_is_refused() -> None:
    assert refused_robot(ROBOT._replace(watchdog_s=3.0)) == (
        "device.motors.watchdog: DRIVES_CONTROL.Timeout takes 0 to 2000 ms, and firmware.watchdog_s = 3 is outside; "
        "change that, or correct unit or scale"
    )


def test_wheels_are_named_once() -> None:
    swapped = refused_robot(ROBOT._replace(wheel_of_channel=(1, 0, 2, 3)))
    assert swapped.startswith("device.wheels = ['fr', 'fl', 'rr', 'rl']: device.motors names the signals of each wheel")
    turned = refused_robot(ROBOT._replace(speed_limit_rad_s=40.0, sign_of_channel=(1, -1, -1, 1)), "twist_base")
    assert turned.startswith("device.reversed is not empty")
