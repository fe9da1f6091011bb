"""Short runs with faults, for tests: a scenario from rows, and its result."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from hil.runtime.assembly import RunResult, run

LINKS = ("memory:", "serial:pty", "can:virtual/faults")
Row = Mapping[str, str | float]


def scenario_text(rows: Iterable[Row], base: str = "circle_speed", duration_s: float = 1.0) -> str:
    """Return a scenario of so many seconds with these faults and no expectations of its own."""
    text = [f'extends = "{base}"', f"[loop]\nduration_s = {duration_s}"]
    for row in rows:
        text.append("[[fault]]")
        text += [f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value}" for key, value in row.items()]
    return "\n".join(text) + "\n"


def write(folder: Path, rows: Iterable[Row], **more: str | float) -> Path:
    """Write such a scenario and return its path."""
    path = folder / "faulty.toml"
    path.write_text(scenario_text(rows, **more), encoding="utf-8")
    return path


def run_with(folder: Path, *rows: Row, link: str = "memory:", seed: int = 1, changes=(), **more) -> RunResult:
    """Run it, with ``--set`` for each of ``changes``."""
    return run(write(folder, rows, **more), link=link, seed=seed, set=list(changes))


def applied(result: RunResult) -> list[int]:
    """Return how often each row was applied."""
    return [row["applied"] for row in result.metrics["fault"]]
