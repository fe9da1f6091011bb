"""Bad input: each mistake gives one sentence with the place, the key, the value and the remedy."""

from pathlib import Path

import pytest

from hil.core.errors import BadInputError
from hil.scenario import load, shipped_scenarios

BASE = 'extends = "paper_circle"\n'
DROP = "[[fault]]\nkind = 'drop'\ntarget = 'command'\n"
MUTE = "[[fault]]\nkind = 'mute'\n"
EXPECT = "[[expect]]\nsignal = 'error.planar_m'\n"


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def message(name: str = "my.toml", **options: object) -> str:
    with pytest.raises(BadInputError) as caught:
        load(name, **options)  # type: ignore[arg-type]
    return str(caught.value)


def message_of(text: str) -> str:
    Path("my.toml").write_text(text, "utf-8")
    return message()


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("[robot]\nmas_kg = 3", "my.toml:3: unknown key robot.mas_kg; did you mean 'robot.mass_kg'?"),
        ("[robot]\nmass_g = 3", "my.toml:3: unknown key robot.mass_g; did you mean 'robot.mass_kg'?"),
        ("mass = 3", "my.toml:2: unknown key mass; did you mean 'robot.mass_kg'?"),
        ("mass_kg = 3", "my.toml:2: unknown key mass_kg; did you mean 'robot.mass_kg'?"),
        ("[robot]\nrate_hz = 3", "unknown key robot.rate_hz; did you mean 'loop.rate_hz'?"),
        ("[robto]\nmass_kg = 3", "my.toml:3: unknown key robto; did you mean 'robot'?"),
        ("[controller]\nk1_1_s = 3", "unknown key controller.k1_1_s; known: command, gains, law"),
        (EXPECT + "belwo = 1", "my.toml:4: unknown key expect.1.belwo; did you mean 'expect.1.below'?"),
    ],
)
def test_a_key_that_is_unknown(text: str, sentence: str) -> None:
    assert sentence in message_of(BASE + text)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            "[robot]\nmass_kg = -3",
            "my.toml:3: robot.mass_kg = -3; expected a number greater than 0 and at most 10000",
        ),
        ("[robot]\nmass_kg = '3'", 'robot.mass_kg = "3"; expected a number'),
        ("[robot]\nmass_kg = true", "robot.mass_kg = true; expected a number"),
        ("[robot]\nmass_kg = nan", "robot.mass_kg = nan; expected a finite number"),
        ("[robot]\nmass_kg = 2020-01-01", "robot.mass_kg = 2020-01-01; expected a number"),
        ("[robot]\nwheel_radius_m = 75", "expected a number from 0.001 to 1"),
        ("[robot]\nfriction_coefficient = -1", "expected a number from 0 to 2"),
        ("robot = 3", "my.toml:2: robot = 3; expected a table"),
        (
            "[plant]\nfmu = 'mecanm'",
            'plant.fmu = "mecanm"; expected a shipped FMU or a path to one; did you mean',
        ),
        ("[[expect]]\nsignal = 'error.x_m'\nwithin = 1.0", "expect.1.within = 1.0; expected two numbers: [low, high]"),
        ("[plant.start]\nx = [1]", "plant.start.x = [1]; expected a finite number, a whole one within 64 bits"),
        ("[plant.start]\nx = inf", "plant.start.x = inf; expected a finite number"),
        ("[plant]\ntimeout_s = 0", "plant.timeout_s = 0; expected a number from 0.05 to 3600"),
        ("[firmware]\ncounts_per_revolution = 1.5", "expected a whole number from 4 to 32768"),
        ("[firmware]\nwatchdog_s = 0.5", "firmware.watchdog_s = 0.5; expected a number from 0.02 to 0.1"),
        ("[firmware]\nwatchdog_s = 0.0205", "expected a whole number of milliseconds"),
        ("[device]\ndriver = 'stm31'", "did you mean 'stm32'?"),
        ("[device]\nwheels = ['fl', 'fl', 'rr', 'rl']", 'expected each of "fl", "fr", "rr" and "rl" once'),
        ("[device]\nwheels = ['f', 'fl', 'rr', 'rl']", 'wheels.1 = "f"; expected "fl", "fr", "rr" or "rl"'),
        (
            "[controller]\nshadow = ['dsc']",
            "unknown key controller.shadow; `hil replay RUN --law LAW` computes another law over a recorded run",
        ),
        ("[controller.shadow_gains.dsc]\nk1_1_s = 8.0", "controller.shadow_gains; `hil replay RUN --law LAW` computes"),
        ("[device]\nwheels = 'fl'", 'expected an array, each item "fl", "fr", "rr" or "rl"'),
        ("[device]\nreversed = ['fl', 'fl']", "expected each wheel at most once"),
        ("[link]\nurl = 'serail:/x'", "unknown kind of link 'serail'; did you mean 'serial'?"),
        ("[link]\ncommand_latency_s = 5", "expected a number from 0 to 1"),
        ("[controller]\nlaw = ''", "expected text of one line, not empty"),
        ("[controller]\nlaw = 3", "controller.law = 3; expected text in quotation marks"),
        ("[controller]\ncommand = 'volt'", 'expected "speed" or "torque"'),
        ("[controller]\ngains = 3", "controller.gains = 3; expected a table"),
        ("[controller.gains]\na = nan", "controller.gains.a = nan; expected a finite number, text"),
        ("[controller.gains]\na = [[1]]", "controller.gains.a = [[1]]; expected a finite number, text"),
        ("[controller.gains]\na = {b = 1}", "my.toml:3: controller.gains.a: expected a finite number, text"),
        (
            "[reference]\nkind = 'circel'",
            "my.toml:3: reference.kind = 'circel': unknown; did you mean 'circle'?",
        ),
        (
            "[reference]\nradus_m = 3",
            "my.toml:3: unknown key reference.radus_m; did you mean 'reference.radius_m'?",
        ),
        ("[reference]\nradius_m = -3", "my.toml:3: reference.radius_m = -3; expected a number greater than 0"),
        ("[loop]\nrate_hz = 300", "loop.rate_hz = 300; expected one of 20, 25,"),
        ("[loop]\nrate_hz = 1000.5", "loop.rate_hz = 1000.5; expected a whole number"),
        ("[loop]\nduration_s = 0", "loop.duration_s = 0; expected a number greater than 0"),
        ("[loop]\nmode = 'fast'", 'loop.mode = "fast"; expected "lockstep" or "realtime"'),
        ("[loop]\nseed = -1", "loop.seed = -1; expected a whole number from 0 to 4294967295"),
        ("[expect]\nsignal = 'a'", "my.toml:3: expect: expected an array of tables: write [[...]]"),
        ("[[expect]]\nsignal = 'error.planar'\nbelow = 1", "did you mean 'error.planar_m'?"),
        ("[[expect]]\nsignal = 'zzz'\nbelow = 1", "`hil list signals` prints them all"),
        ("[[expect]]\nbelow = 1", "my.toml:3: expect.1: needs one of `signal`, `figure`, `at_rest = true`, or `stops`"),
        (
            "[[fault]]\nstart_s = 1",
            "my.toml:3: fault.1.kind is missing; expected a kind of fault, one of drop, burst_loss",
        ),
        (
            "[[fault]]\nkind = 'reset'\ntarget = 'robot'\n[[fault]]\nkind = 'drop'",
            "my.toml:6: fault.2.target is missing; expected what drop acts on: command (to the robot), ",
        ),
        (EXPECT, "my.toml:3: expect.1: needs one claim: below or above or both"),
        (EXPECT + "below = 1\nabove = 2", "above = 2.0 is not less than below = 1.0"),
        (EXPECT + "below = 1\nfrom_s = 2\nto_s = 1", "to_s = 1.0 is before from_s = 2.0"),
        (EXPECT + "below = 1\nto_s = nan", "to_s = nan; expected a number greater than 0"),
        (DROP.replace("drop", "drp"), "fault.1: kind = 'drp' is not a kind of fault; did you mean 'drop'?"),
        (
            DROP.replace("'command'", "'comand'"),
            "'comand' is not a target of drop; did you mean 'command'?",
        ),
        (
            DROP + "value = 2",
            "fault.1: value = 2: expected more than 0, at most 1, the probability that a frame is lost",
        ),
        (DROP + "start_s = 2\nend_s = 1", "end_s = 1.0 is not after start_s = 2.0"),
        (MUTE + "target = 'WHEEL_COMAND'", "is not a target of mute; did you mean 'WHEEL_COMMAND'?"),
        (MUTE + "target = 'STEP_DONE'", "'STEP_DONE' is not a target of mute"),
        (MUTE + "target = 'TICK'\nvalue = 0.5", "mute takes no value"),
    ],
)
def test_a_value_that_is_wrong(text: str, sentence: str) -> None:
    text = message_of(BASE + text)
    assert sentence in text
    assert text.startswith("scenario my.toml")
    assert "\n" not in text


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            "[firmware]\nwatchdog_s = 0.02\n[loop]\nrate_hz = 20",
            "my.toml:3: firmware.watchdog_s = 0.02; expected more than",
        ),
        (
            "[robot]\nspeed_limit_rad_s = 50\n[firmware]\noverspeed_rad_s = 50",
            "my.toml:5: firmware.overspeed_rad_s = 50.0; expected more than robot.speed_limit_rad_s = 50",
        ),
    ],
)
def test_values_that_cannot_work_together(text: str, sentence: str) -> None:
    assert sentence in message_of(BASE + text)


def test_a_row_that_compares_signals_of_two_units_is_named_with_its_line() -> None:
    rows = [("pose.x_m", "reference.x_m"), ("pose.x_m", "pose.heading_rad"), ("guard.held", "pose.y_m")]
    text = "".join(f"[[expect]]\nsignal = '{one}'\nof = '{other}'\nbelow = 1.0\n" for one, other in rows)
    sentence = "expected a signal in the unit of {}, to compare them"
    assert message_of(BASE + text).splitlines() == [
        f'scenario my.toml:8: expect.2.of = "pose.heading_rad"; {sentence.format("pose.x_m (m)")}',
        f'scenario my.toml:12: expect.3.of = "pose.y_m"; {sentence.format("guard.held (without a unit)")}',
    ]


def test_what_is_missing_is_named() -> None:
    lines = message_of("[robot]\nmass_kg = 3").splitlines()
    assert "scenario my.toml: robot.wheel_inertia_kg_m2 is missing; expected a number from 0 to 100" in lines
    assert any("the table [loop] is missing; write it, or start with extends" in line for line in lines)


def test_each_problem_has_a_line() -> None:
    lines = message_of(BASE + "[robot]\nmass_kg = -1\ninertia_kg_m2 = -1\n").splitlines()
    assert [line.partition(" = ")[0] for line in lines] == [
        "scenario my.toml:3: robot.mass_kg",
        "scenario my.toml:4: robot.inertia_kg_m2",
    ]


def test_a_misspelt_key_is_not_missing_too() -> None:
    sentence = message_of(BASE + EXPECT.replace("signal", "signl") + "below = 1")
    assert sentence == "scenario my.toml:3: unknown key expect.1.signl; did you mean 'expect.1.signal'?"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("[robot\nmass_kg = 3", "line 1"),
        ("[robot]\nmass_kg =\n", "line 2"),
        ("a = 1\n\na = 2\n", "line 3"),
        ("a =", "line 1"),
    ],
)
def test_a_file_that_is_no_toml(text: str, line: str) -> None:
    sentence = message_of(text)
    assert sentence.startswith("scenario my.toml: not valid TOML: ")
    assert line in sentence


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        (
            "paper_circel",
            "scenario paper_circel: no shipped scenario has this name; did you mean 'paper_circle'?",
        ),
        ("zzz", f"known: {', '.join(shipped_scenarios())};"),
        ("nowhere.toml", "scenario nowhere.toml: there is no file"),
        ("./", "cannot be read"),
    ],
)
def test_a_scenario_that_is_not_there(name: str, sentence: str) -> None:
    assert sentence in message(name)


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("mine", "this name; did you mean the file mine.toml?"),
        ("first_circle", "this name; did you mean the file first_circle.hil.toml?"),
        ("first-circl", "this name; did you mean the file first_circle.hil.toml?"),
        ("frist_circle.hil.toml", "did you mean the file first_circle.hil.toml?"),
        ("my robot/bad_dya.toml", "did you mean the file 'my robot/bad_day.hil.toml'?"),
        ("my robot", "this is a folder, which has 'my robot/bad_day.hil.toml'"),
        ("my robot/", "this is a folder, which has 'my robot/bad_day.hil.toml'"),
    ],
)
def test_a_file_that_is_named_nearly(name: str, hint: str) -> None:
    Path("my robot").mkdir()
    for file in ("mine.toml", "first_circle.hil.toml", "first_circle.baseline.toml", "my robot/bad_day.hil.toml"):
        Path(file).write_text(BASE, "utf-8")
    assert hint in message(name)


def test_a_key_of_two_tables_is_named_with_both() -> None:
    sentence = message_of(BASE + "torque_limit_n_m = 3")
    assert "did you mean 'robot.torque_limit_n_m' or 'firmware.torque_limit_n_m'?" in sentence


def test_a_file_that_is_not_text() -> None:
    Path("my.toml").write_bytes(b"\xff\x00")
    assert "cannot be read as TOML text in UTF-8" in message()


@pytest.mark.parametrize(
    ("extends", "sentence"),
    [
        (
            '"paper_circl"',
            "scenario my.toml:1: extends = 'paper_circl': no shipped scenario has this name; did you mean",
        ),
        ('"nowhere.toml"', "scenario my.toml:1: extends = 'nowhere.toml': there is no file"),
        ('"a\\u0000.toml"', "cannot be read"),
        ("3", "scenario my.toml:1: extends = 3; expected a shipped name or the path of a file"),
        ('"my.toml"', "leads back to itself: my.toml -> my.toml"),
        ('"other.toml"', "leads back to itself: my.toml -> other.toml -> my.toml"),
    ],
)
def test_a_base_that_cannot_be(extends: str, sentence: str) -> None:
    Path("other.toml").write_text('extends = "./my.toml"', "utf-8")
    assert sentence in message_of(f"extends = {extends}")


@pytest.mark.parametrize(
    ("assignment", "sentence"),
    [
        ("robot.mas_kg=3", "--set: unknown key robot.mas_kg; did you mean 'robot.mass_kg'?"),
        ("robot.mass_kg=-1", "--set: robot.mass_kg = -1; expected a number greater than 0"),
        ("robot.mass_kg=24 kg", '--set: robot.mass_kg = "24 kg"; expected a number'),
        ("robot.mass_kg.x=1", "--set: robot.mass_kg: expected a number"),
        ("robot.mass_kg", "--set robot.mass_kg: expected key=value, such as robot.mass_kg=24"),
        ("=3", "--set =3: expected key=value"),
        ("robot..mass_kg=3", "expected a dotted key such as robot.mass_kg"),
        ("reference.radus_m=3", "--set: unknown key reference.radus_m; did you mean 'reference.radius_m'?"),
        ("expect.2.below=3", "--set expect.2.below: expected expect.N.KEY with the row N from 1 to 1"),
        ("expect.0.below=3", "--set expect.0.below: expected expect.N.KEY with the row N from 1 to 1"),
        ("expect.first.below=3", "expected expect.N.KEY"),
        ("expect.1=3", "--set: expect.1 = 3; expected a table"),
        ("fault.1.kind=drop", "--set fault.1.kind: there is no [[fault]] to change"),
        ("extends=paper_circle", "--set extends: only a file can extend another"),
    ],
)
def test_an_assignment_that_is_wrong(assignment: str, sentence: str) -> None:
    assert sentence in message("paper_circle", set=[assignment])


@pytest.mark.parametrize(
    ("sets", "sentences"),
    [
        (["fault.1.value=1"], ["--set fault.1.value: there is no [[fault]] to change; add one to a file"]),
        (
            ["fault=[{name='a',kind='estop'},{name='b',kind='estop'},{name='a',kind='estop'}]"],
            ['--set: fault.3.name = "a"; another fault has this name; expected one of its own'],
        ),
        (
            ["estimator.source='fused'", "estimator.fix='udp://127.0.0.1:5000'"],
            ['; expected "simulated" in lockstep: no other program follows its time; or give loop.mode = "realtime"'],
        ),
    ],
)
def test_what_a_scenario_or_its_robot_has_not(sets: list[str], sentences: list[str]) -> None:
    told = message("circle_speed", set=sets).splitlines()
    assert len(told) == len(sentences)
    for line, sentence in zip(told, sentences, strict=True):
        assert line.endswith(sentence)


def test_an_option_that_is_wrong() -> None:
    assert message("paper_circle", mode="fast").startswith('--mode: loop.mode = "fast"')
    assert message("paper_circle", link="x:").startswith('--link: link.url = "x:"')
    assert message("paper_circle", seed=-1).startswith("--seed: loop.seed = -1")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("[robot]\nmass_kg = -3", "--robot r.toml:2: robot.mass_kg = -3; expected"),
        ("[loop]\nrate_hz = 100", "--robot r.toml: 'loop' cannot be in a robot's file"),
        ("[frimware]\nramp_s = 1", "did you mean 'firmware'?"),
        ("[robot", "--robot r.toml: not valid TOML"),
        ("# cut", "--robot r.toml: it holds nothing; expected the tables of a robot"),
    ],
)
def test_a_robots_file_that_is_wrong(text: str, sentence: str) -> None:
    Path("r.toml").write_text(text, "utf-8")
    assert sentence in message("paper_circle", robot="r.toml")


def test_a_robots_file_that_is_not_there() -> None:
    assert message("paper_circle", robot="r.toml") == "--robot r.toml: there is no file 'r.toml'"
