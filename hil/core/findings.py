"""The findings of ``hil doctor``. They are in the core because any add-on may register a check (``hil.checks``)."""

from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import NamedTuple


class Level(StrEnum):
    """How much a finding matters."""

    OK = "ok"
    NOTE = "note"
    """It works and could be better, or not everyone needs it."""
    PROBLEM = "problem"
    """Something that runs need does not work."""


class Finding(NamedTuple):
    """One sentence on one subject, and the remedy unless it is ``ok``."""

    verdict: Level
    subject: str
    sentence: str
    remedy: str = ""


ok, note, problem = (partial(Finding, level) for level in Level)


def ok_or_note(subject: str, is_ok: bool, fact: str, shortcoming: str, remedy: str) -> Finding:
    """Return the finding ``fact`` if it is ok, else the note ``shortcoming`` with its remedy."""
    return ok(subject, fact) if is_ok else note(subject, shortcoming, remedy)


def text_of(path: Path) -> str | None:
    """Return the stripped text of a file such as those in /sys; None if it cannot be read."""
    try:
        return path.read_text("utf-8").strip()
    except OSError:
        return None
