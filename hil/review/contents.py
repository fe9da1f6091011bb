"""What the file of a recording holds, whatever its format."""

import json
from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]
Wanted = Collection[str] | None
"""Names of the signals to read; None for all."""


class DamagedError(Exception):
    """The file cannot be read as a recording of a run; the text says what is wrong with it."""


class Contents(NamedTuple):
    """A file as it was read: signals by name, events, and the texts of each property."""

    signals: dict[str, Series]
    events: list[tuple[float, str, str]]
    properties: dict[str, dict[str, str]]

    def json(self, name: str) -> dict[str, Any] | None:
        """Return a property that holds a JSON object, or None when the recording does not have it.

        Raises DamagedError when it has another.
        """
        return json_property(self.properties, name)


def json_property(properties: dict[str, dict[str, str]], name: str) -> dict[str, Any] | None:
    """See ``Contents.json``."""
    texts = properties.get(name)
    if texts is None:
        return None
    try:
        value = json.loads(texts["json"])
    except (KeyError, ValueError):
        value = None
    if not isinstance(value, dict):
        raise DamagedError(f"damaged: its property {name!r} is not readable")
    return value
