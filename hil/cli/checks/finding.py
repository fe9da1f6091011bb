"""What a check has found."""

from enum import StrEnum
from pathlib import Path
from typing import NamedTuple


class Verdict(StrEnum):
    """How it is."""

    OK = "ok"
    NOTE = "note"
    """It works, and could be better; or it is something that not everyone needs."""
    PROBLEM = "problem"
    """Something that runs need does not work."""


class Finding(NamedTuple):
    """One sentence on one thing, and unless it is ``ok``, what to do."""

    verdict: Verdict
    subject: str
    sentence: str
    remedy: str = ""


def ok(subject: str, sentence: str) -> Finding:
    """Return that something is as it should be."""
    return Finding(Verdict.OK, subject, sentence)


def note(subject: str, sentence: str, remedy: str) -> Finding:
    """Return that something could be better."""
    return Finding(Verdict.NOTE, subject, sentence, remedy)


def problem(subject: str, sentence: str, remedy: str) -> Finding:
    """Return that something does not work."""
    return Finding(Verdict.PROBLEM, subject, sentence, remedy)


def text_of(path: Path) -> str | None:
    """Return what a file of the kernel's says, None where it cannot be read."""
    try:
        return path.read_text("utf-8").strip()
    except OSError:
        return None
