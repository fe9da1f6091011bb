"""Laws by name, from files and from modules; and the sentence that each mistake gets."""

import dataclasses
import sys
from pathlib import Path
from textwrap import dedent

import pytest

from hil.core import extensions
from hil.core.errors import BadInputError
from hil.core.types import NO_GAINS, CommandMode, Pose, State, Twist
from hil.laws import law_registry as registry
from hil.laws.afdsc import Afdsc
from hil.laws.law_registry import laws, load_law, make_controller, shipped_laws
from hil.laws.surface import Dsc
from tests.support.closed_loop import AT_REST, PAPER_CIRCLE, PAPER_ROBOT
from tests.support.documented import defaults, sections
from tests.support.processes import hil

SHIPPED = shipped_laws()

HERE = Path()
REFERENCE = PAPER_CIRCLE.at(0.0)
STATE = State(Pose(0.8, -0.2, 0.0), Twist(0.0, 0.0, 0.0))

PROPORTIONAL = """
    from dataclasses import dataclass
    from typing import Literal

    from hil.core.types import ZERO_WHEELS, Twist, WheelCommand

    class Proportional:
        @dataclass(frozen=True)
        class Options:
            gain_1_s: float = 2.0
            axes: Literal["x", "xy"] = "xy"
            order: int = 1
            label: str = ""
            on: bool = True
            free: object = None

            def __post_init__(self):
                if self.gain_1_s > 20.0:
                    raise ValueError(f"gain_1_s = {self.gain_1_s}: expected 20 at most")

        def __init__(self, model, mode, options):
            self.model, self.mode, self.options = model, mode, options

        def reset(self, state, reference):
            pass

        def update(self, reference, state, applied, dt_s):
            away = [a - b for a, b in zip(reference.pose, state.pose)]
            wanted = Twist(*(self.options.gain_1_s * a for a in away))
            speeds = self.model.wheel_speeds(wanted, state.pose.heading_rad)
            return WheelCommand(self.mode, speeds, ZERO_WHEELS)
"""

BARE = """
    class Law:
        {constructor}
        def reset(self, state, reference): {reset}
        def update(self, reference, state, applied, dt_s): {update}
"""


@pytest.fixture
def write(tmp_path):
    """Return a function that writes a user's file and returns its folder."""

    def write_file(text: str, name: str = "my_law.py") -> Path:
        (tmp_path / name).write_text(dedent(text).lstrip(), encoding="utf-8")
        return tmp_path

    return write_file


def bare(constructor: str = "", reset: str = "pass", update: str = "pass") -> str:
    return BARE.format(constructor=constructor, reset=reset, update=update)


def make(spec, base=HERE, options=None, mode=CommandMode.SPEED):
    return make_controller(spec, base, PAPER_ROBOT, mode, options or {})


def message_of(call, *arguments) -> str:
    with pytest.raises(BadInputError) as caught:
        call(*arguments)
    return str(caught.value)


def test_shipped_laws_have_a_name_and_a_line():
    assert load_law("dsc", HERE) is Dsc
    assert load_law("afdsc", HERE) is Afdsc
    listed = {name: line for name, package, line in laws() if package == "mecanum-hil"}
    assert set(listed) == set(SHIPPED)
    assert all(line.endswith(".") and len(line) < 110 for line in listed.values())


@pytest.mark.parametrize("name", SHIPPED)
def test_the_pages_have_every_option_of_a_law_with_its_default(name):
    folder = Path(registry.__file__).parent
    found = {}
    if name == "profile":
        found |= defaults(sections((folder / "PROFILE.md").read_text(encoding="utf-8"))["Options"])
    for heading, section in sections((folder / "LAWS.md").read_text(encoding="utf-8")).items():
        if f"`{name}`" in heading or (name == "afdsc_eso" and "`afdsc`" in heading):
            found |= defaults(section)
    own = {field.name: field.default for field in dataclasses.fields(SHIPPED[name].Options)}
    assert own == {option: found[option] for option in own}


def test_options_reach_the_law():
    assert make("dsc", options={"k1_1_s": 8}).gains[0] == 8.0
    assert isinstance(make("afdsc", options={"filter_s": 0.02}), Afdsc)


def test_a_law_from_a_file(write):
    base = write(PROPORTIONAL)
    law = make("./my_law.py:Proportional", base, {"gain_1_s": 3, "axes": "x"})
    law.reset(STATE, REFERENCE)
    command = law.update(REFERENCE, STATE, AT_REST, 0.005)
    found = PAPER_ROBOT.twist(command.speed_rad_s, 0.0)
    assert found == pytest.approx((3 * 0.2, 3 * 0.2, 3 * REFERENCE.pose.heading_rad))
    assert law.gains == NO_GAINS


def test_a_law_from_a_module(write, monkeypatch):
    monkeypatch.syspath_prepend(write(PROPORTIONAL, "law_in_a_module.py"))
    assert load_law("law_in_a_module:Proportional", HERE).__name__ == "Proportional"
    assert make("hil.laws.surface:Dsc", options={"k1_1_s": 7.0}).gains[0] == 7.0


def test_a_file_named_as_a_module_does_not_replace_it(write):
    import random

    load_law("random.py:Law", write(bare(), "random.py"))
    assert sys.modules["random"] is random


@pytest.mark.parametrize("constructor", ["", "def __init__(self, model, mode): pass"])
def test_a_law_without_options_takes_none(write, constructor):
    base = write(bare(constructor))
    assert make("my_law.py:Law", base).gains == NO_GAINS
    message = message_of(make, "my_law.py:Law", base, {"k1_1_s": 1.0})
    assert message == "unknown key controller.gains.k1_1_s; it takes none"


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("afdcs", "controller.law = 'afdcs': unknown; did you mean 'afdsc'?"),
        ("lqr", f"controller.law = 'lqr': unknown; known: {', '.join(sorted(SHIPPED))}"),
        ("my_law.py", "controller.law = 'my_law.py': name the class too, as in 'my_law.py:MyLaw'"),
        (
            "no_such_package.law:Law",
            "controller.law = 'no_such_package.law:Law': no module 'no_such_package'; install it, or name a "
            "file as in './my_law.py:MyLaw'",
        ),
        (
            "hil.laws.surface:Dcs",
            "controller.law = 'hil.laws.surface:Dcs': no class 'Dcs' in hil.laws.surface",
        ),
        (
            "hil.core.types:WHEEL_NAMES",
            "controller.law = 'hil.core.types:WHEEL_NAMES': no class 'WHEEL_NAMES' in hil.core.types",
        ),
        (
            "hil.core.types:Pose",
            "controller.law = 'hil.core.types:Pose': the class has no reset; expected reset(self, state, ref",
        ),
        (":Law", "controller.law = ':Law': importing it failed"),
    ],
)
def test_a_law_that_is_not_there(spec, message):
    assert message_of(load_law, spec, HERE).startswith(message)


def test_a_file_that_is_not_there(tmp_path):
    assert message_of(load_law, "./laws/mine.py:Law", tmp_path) == (
        f"controller.law = './laws/mine.py:Law': no file {tmp_path / 'laws' / 'mine.py'} (relative to the scenario's "
        "folder)"
    )


def test_the_nearest_class_is_named(write):
    message = message_of(load_law, "my_law.py:Proportionall", write(PROPORTIONAL))
    assert message.endswith("no class 'Proportionall' in my_law.py; did you mean 'Proportional'?")
    message = message_of(load_law, "empty.py:Law", write("x = 1\n", "empty.py"))
    assert message.endswith("no class 'Law' in empty.py; it has none")


@pytest.mark.parametrize(
    ("text", "place_and_error"),
    [
        ("import json\n\nvalue = 1 / 0\n", "my_law.py:3 (value = 1 / 0): ZeroDivisionError: division by zero"),
        ("class Law:\n    def update(self:\n", "my_law.py:2: SyntaxError: '(' was never closed"),
        (
            "import not_installed_here\n",
            "my_law.py:1 (import not_installed_here): ModuleNotFoundError: No module named 'not_installed_here'",
        ),
        ("import sys\nsys.exit('no')\n", "my_law.py:2 (sys.exit('no')): SystemExit: no"),
        ("import json\njson.loads('{')\n", "my_law.py:2 (json.loads('{')): JSONDecodeError: Expecting property name"),
        ("import numpy\nnumpy.ones(2).reshape(3)\n", "my_law.py:2 (numpy.ones(2).reshape(3)): ValueError: cannot resh"),
        ("import numpy\nnumpy.linalg.inv([[0.0]])\n", "my_law.py:2 (numpy.linalg.inv([[0.0]])): LinAlgError: Singular"),
        (
            "import functools\n\ndef add(a, b):\n    return a / b\n\nfunctools.reduce(add, [1, 0])\n",
            "my_law.py:4 (return a / b): ZeroDivisionError",
        ),
        (
            "from hil.core.kinematics import body_twist\nbody_twist((1.0, 2.0), 0.1, 0.2)\n",
            "my_law.py:2 (body_twist((1.0, 2.0), 0.1, 0.2)): ",
        ),
    ],
)
def test_a_file_that_fails_on_import(write, text, place_and_error):
    before = set(sys.modules)
    message = message_of(load_law, "my_law.py:Law", write(text))
    assert message.startswith("controller.law = 'my_law.py:Law': importing it failed at ")
    assert place_and_error in message
    assert not [name for name in set(sys.modules) - before if "my_law" in name]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "class Law:\n    def reset(self, state, reference): ...",
            "the class has no update; expected update(self, ref",
        ),
        (
            "class Law:\n    def update(self, r, s, a, dt): ...",
            "the class has no reset; expected reset(self, state",
        ),
        (
            "class Law:\n    def reset(self, s, r): ...\n    def update(self, reference, state): ...",
            "found update(self, reference, state), expected update(self, reference, state, applied, dt_s)",
        ),
    ],
)
def test_a_class_that_is_no_law(write, text, message):
    assert f"controller.law = 'my_law.py:Law': {message}" in message_of(load_law, "my_law.py:Law", write(text))


def test_a_method_of_compiled_code_may_not_tell_its_arguments(write):
    base = write("class Law:\n    def reset(self, state, reference): ...\n    update = max")
    assert load_law("my_law.py:Law", base)


def test_a_constructor_that_takes_something_else(write):
    base = write(bare("def __init__(self, model, mode, options): pass"))
    message = message_of(make, "my_law.py:Law", base)
    assert "found Law(model, mode, options), expected __init__(self, model, mode); for options, define" in message


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (
            {"constructor": "def __init__(self): raise KeyError('x')"},
            "making it failed at {file}:2 (def __init__(self): raise KeyError('x')): KeyError: 'x'",
        ),
        (
            {"reset": "self.a"},
            "reset failed at {file}:3 (def reset(self, state, reference): self.a): "
            "AttributeError: 'Law' object has no attribute 'a'",
        ),
        (
            {"update": "return 1 / 0"},
            "update failed at {file}:4 (def update(self, reference, state, applied, dt_s): return 1 / 0): "
            "ZeroDivisionError: division by zero",
        ),
        (
            {"update": "raise SystemExit('no')"},
            "update failed at {file}:4 (def update(self, reference, state, applied, dt_s): raise SystemExit('no')): "
            "SystemExit: no",
        ),
        ({"update": "pass"}, "update returned None, expected a WheelCommand"),
        (
            {"update": "return applied.command"},
            "update returned a command of mode TORQUE, expected SPEED, the mode that it was made with",
        ),
        (
            {"update": "return type(applied.command)(0, (1, 2, 3), None)"},
            "update returned WheelCommand(mode=0, speed_rad_s=(1, 2, 3), torque_n_m=None), expected four numbers in "
            "speed_rad_s and four in torque_n_m (not enough values to unpack (expected 4, got 3))",
        ),
    ],
)
def test_a_law_that_fails_while_it_runs(write, parts, message):
    base = write(bare(**parts))

    def run():
        law = make("my_law.py:Law", base)
        law.reset(STATE, REFERENCE)
        law.update(REFERENCE, STATE, AT_REST, 0.005)

    expected = "controller.law = 'my_law.py:Law': " + message.format(file=base / "my_law.py")
    assert message_of(run) == expected


def test_the_line_of_a_failure_is_the_users_and_the_traceback_is_printed_after_traceback(write):
    """numpy's own lines, below that of the law, do not help to fix it; they are there on request."""
    folder = write("import numpy\nnumpy.linalg.inv([[0.0]])\n")
    message = message_of(load_law, "my_law.py:Law", folder)
    assert "linalg" not in message.partition(" (")[0]
    run = ["check", "circle_speed", "--set", f"controller.law={folder / 'my_law.py'}:Law"]
    told, asked = hil(*run), hil("--traceback", *run)
    assert (told.returncode, asked.returncode) == (2, 2)
    assert "Traceback" not in told.stderr
    assert asked.stderr.startswith("Traceback (most recent call last):\n")
    assert "_raise_linalgerror_singular" in asked.stderr
    assert asked.stderr.endswith(told.stderr)
    assert hil(*run).stderr == told.stderr  # it is of one command


def test_the_line_of_a_failure_is_the_users_where_this_package_is_below_their_folder():
    place = Path(extensions.__file__).parents[2] / "my_law.py"  # in a checkout of this package
    theirs = compile("from hil.core.kinematics import body_wrench\nbody_wrench(None, 1.0, 1.0)\n", place, "exec")
    with pytest.raises(TypeError) as raised:
        exec(theirs, {})
    error = raised.value.with_traceback(raised.value.__traceback__.tb_next)  # without this test's own frame
    assert "my_law.py:2" in str(extensions.failure("a law", "update", error))


def test_the_line_of_a_failure_is_the_users_where_this_package_is_installed(write, monkeypatch):
    monkeypatch.setattr(extensions, "_LIBRARIES", ("site-packages", Path(extensions.__file__).parents[2].name))
    folder = write("import numpy\nnumpy.linalg.inv([[0.0]])\n")
    assert "my_law.py:2 (numpy.linalg.inv" in message_of(load_law, "my_law.py:Law", folder)


@pytest.mark.parametrize(
    ("spec", "options", "message"),
    [
        ("dsc", {"k1": 8.0}, "unknown key controller.gains.k1; "),
        ("dsc", {"k1_1s": 8.0}, "unknown key controller.gains.k1_1s; did you mean 'controller.gains.k1_1_s'?"),
        ("dsc", {"k1_1_s": -1}, "controller.gains.k1_1_s = -1; expected a number greater than 0"),
        (
            "dsc",
            {"filter_s": 0.0},
            "controller.gains.filter_s = 0.0; expected a number greater than 0",
        ),
        ("dsc", {"filter_s": "fast"}, 'controller.gains.filter_s = "fast"; expected a number'),
        ("dsc", {"filter_s": float("nan")}, "controller.gains.filter_s = nan; expected a finite number"),
        ("afdsc", {"k1_1_s": 8.0}, "unknown key controller.gains.k1_1_s; "),
        (
            "afdsc_eso",
            {"tables": "print"},
            'controller.gains.tables = "print"; expected "printed" or "corrected"',
        ),
        (
            "my_law.py:Proportional",
            {"gain_1_s": 21},
            "controller.gains: gain_1_s = 21.0: expected 20 at most",
        ),
        ("my_law.py:Proportional", {"order": 1.5}, "controller.gains.order = 1.5; expected a whole number"),
        ("my_law.py:Proportional", {"order": True}, "controller.gains.order = true; expected a whole number"),
        ("my_law.py:Proportional", {"label": 3}, "controller.gains.label = 3; expected text in quotation marks"),
        ("my_law.py:Proportional", {"on": 1}, "controller.gains.on = 1; expected true or false"),
    ],
)
def test_wrong_options(write, spec, options, message):
    assert message_of(make, spec, write(PROPORTIONAL), options).startswith(message)


def test_an_option_without_default_must_be_given(write):
    text = """
        from dataclasses import dataclass

        class Law:
            @dataclass
            class Options:
                gain: float

            def __init__(self, model, mode, options): pass
            def reset(self, state, reference): pass
            def update(self, reference, state, applied, dt_s): pass
    """
    message = message_of(make, "my_law.py:Law", write(text))
    assert message == "controller.gains.gain is missing; expected a number"
