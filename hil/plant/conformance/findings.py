"""What a check finds, and of which kind it is. Only a violation of the standard fails an FMU."""

from dataclasses import dataclass
from enum import StrEnum


class Kind(StrEnum):
    """What a finding means for the FMU."""

    VIOLATION = "violation"  # the standard demands otherwise
    ADVICE = "advice"  # the importer should not have done this: the standard lets the FMU do with it what it likes
    NEED = "need"  # the standard allows it, but a run of this importer ends with it


@dataclass(frozen=True)
class Finding:
    """One thing that was found, as a sentence."""

    kind: Kind
    text: str


def violation(text: str) -> Finding:
    """Return a violation of the standard."""
    return Finding(Kind.VIOLATION, text)


def advice(text: str) -> Finding:
    """Return something that an FMU may do, and better does not."""
    return Finding(Kind.ADVICE, text)


def need(text: str) -> Finding:
    """Return something that the standard allows and this importer cannot go on with."""
    return Finding(Kind.NEED, text)
