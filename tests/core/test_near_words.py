"""Hints for misspelt names: the one that was meant, and none where nothing is near."""

from collections.abc import Iterator
from dataclasses import is_dataclass

import pytest

from hil.core.errors import near, nearest
from hil.core.options import options_of
from hil.core.signals import SIGNAL_NAMES
from hil.faults.kinds import MESSAGES, names
from hil.laws.law_registry import shipped_laws
from hil.scenario.tables import Tables

SHIPPED = shipped_laws()

LINKS = ("can", "memory", "serial")
KEYS = tuple(key for table in options_of(Tables).values() if is_dataclass(table.type) for key in options_of(table.type))


def typos(word: str) -> Iterator[str]:
    """Yield the word with a letter lost, doubled or wrong, or with two letters swapped."""
    for i, letter in enumerate(word):
        if letter not in "._":
            rest = word[i + 1 :]
            yield from (word[:i] + rest, word[:i] + letter + letter + rest, word[:i] + "q" + rest)
            if rest and rest[0] not in "._":
                yield word[:i] + rest[0] + letter + rest[1:]


@pytest.mark.parametrize(
    "known",
    [names(), tuple(SHIPPED), MESSAGES, KEYS, SIGNAL_NAMES[::7]],
    ids=["kinds", "laws", "messages", "keys", "signals"],
)
def test_what_was_misspelt_by_one_letter_is_named(known) -> None:
    # A wrong letter may make too much of a difference to a short part.
    cases = [(typo, word) for word in known if len(word) > 3 for typo in typos(word) if typo not in known]
    missed = [(typo, near(typo, known)) for typo, word in cases[::7] if word not in near(typo, known)]
    assert len(missed) <= len(cases[::7]) // 50, missed


@pytest.mark.parametrize(
    ("word", "known", "found"),
    [
        ("Bit-Error", names(), ["bit_errors"]),
        ("encoder", names(), ["stuck_encoder"]),
        ("real-time", ("lockstep", "realtime"), ["realtime"]),
        ("wheel.FL.speed_rad_s", SIGNAL_NAMES, ["wheel.fl.speed_rad_s"]),
        ("wheel.fl.speed", SIGNAL_NAMES, ["wheel.fl.speed_rad_s", "wheel.fl.speed_command_rad_s"]),
        ("COMMAND", MESSAGES, ["WHEEL_COMMAND", "TORQUE_COMMAND"]),
        ("mem", LINKS, ["memory"]),
        ("reference.v_m_s", SIGNAL_NAMES, ["reference.vx_m_s", "reference.vy_m_s"]),
    ],
)
def test_capitals_hyphens_and_parts_of_a_name_are_understood(word, known, found) -> None:
    assert near(word, known) == found


@pytest.mark.parametrize(
    ("word", "known"),
    [
        *((word, names()) for word in ("corruption", "friction", "ofset", "latency", "noise", "t", "")),
        *((word, SIGNAL_NAMES) for word in ("robot.voltage", "truth.v_m_s", "wheel.speed", "speed", "m_s")),
        *((word, LINKS) for word in ("usb", "tcp", "uart")),
        ("pid", ("dsc", "afdsc")),
        ("word", ()),
    ],
)
def test_what_only_looks_alike_is_no_hint(word, known) -> None:
    assert near(word, known) == []
    assert "did you mean" not in nearest(word, known)


def test_the_choice_is_told_where_nothing_is_near() -> None:
    assert nearest("usb", LINKS) == "; known: can, memory, serial"
    assert nearest("usb", ()) == ""
