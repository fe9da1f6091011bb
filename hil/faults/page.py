"""Writes FAULTS.md, the page of all kinds of faults, from the table in ``kinds``.

``python -m hil.faults.page`` writes it, ``--check`` fails when it is not as it would be written.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

from hil.faults.kinds import KINDS, Kind, Quantity

PAGE = Path(__file__).with_name("FAULTS.md")

_INTRODUCTION = """\
# Faults

<!-- Written by python -m hil.faults.page from hil/faults/kinds.py. -->

A row of `[[fault]]` in a scenario makes something go wrong while a run goes on:

    [[fault]]
    kind = "drop"
    target = "command"
    start_s = 1.0
    end_s = 2.0
    value = 0.2

- The window is `start_s` <= t < `end_s`, in seconds since the first ACTIVE tick; by default the whole run. In lockstep
  a link is used once in a command period, which is the grain of its windows; on the robot it is the tick of 1 ms.
- Chance comes from `loop.seed` and from what the row itself says. The same seed gives the same run, bit for bit in
  lockstep, and removing a row changes nothing for the others.
- Rows act in the order of the scenario, each on what the ones before it left.
- Every row reports how often it was applied, in the figures (`fault`, key `applied`), the report and the recording.
  A row that was never applied fails the run: it has shown nothing.
- STEP, STEP_DONE and HELLO are spared by all faults of the link: they carry no control.
- Faults of the device and of the plant act inside the virtual robot. One in another process (`hil device`) gets them
  through its truth socket, so `hil run` needs `--truth`; on a real board they are refused.
- No fault of a signal gets round the guard, and none arms the robot.

`hil list faults` prints the kinds in short.
"""

_TITLES = {
    "link": "On the link",
    "device": "On the device",
    "plant": "On the plant",
    "signal": "On signals",
}

_WORDS = {
    "link": """\
The host's end of the link applies them, between the latency of `[link]` and the wire, in both directions.
""",
    "device": """\
They act between the firmware and its plant, exact to the tick. The wheel is the scenario's, whichever channel it has.
""",
    "plant": """\
They change variables of the FMU between two ticks; at the end of the window each is what it was at the start of the
run. Where several rows mean the same variable the last one in force counts. An FMU for model exchange, or without the
variable, is refused. Forces of `push` are in the world frame.
""",
    "signal": """\
Sensors (`wheel.*.speed_rad_s`, `wheel.*.current_a`, `robot.*`, `truth.*`) act before the estimator, `pose.*` and
`twist.*` behind it, `reference.*` before the law, and `wheel.*.speed_command_rad_s` and `wheel.*.torque_command_n_m`
between the law and the guard, which limits them as it limits the law. All other signals, which nothing in the tick
reads, change what is recorded and judged. A signal without a value (NaN) cannot be biased.
""",
}


def page() -> str:
    """Return the page."""
    return "\n".join([_INTRODUCTION, *_sections()])


def _sections() -> Iterator[str]:
    for acts_on, title in _TITLES.items():
        kinds = [kind for kind in KINDS if kind.acts_on == acts_on]
        yield f"## {title}\n\n{_WORDS[acts_on]}"
        yield from map(_section, kinds)


def _section(kind: Kind) -> str:
    rows = [f"- target: {kind.target_words}"]
    rows += [_quantity(quantity) for quantity in (kind.value, *kind.further) if quantity is not None]
    if kind.is_instant:
        rows.append("- no `end_s`: it happens at `start_s`")
    rows.append(f"- applied counts: {kind.counts}")
    example = [f'    kind = "{kind.name}"', *(f"    {key} = {_toml(value)}" for key, value in kind.example.items())]
    return "\n".join([f"### {kind.name}", "", kind.meaning, "", *rows, "", "    [[fault]]", *example, ""])


def _quantity(quantity: Quantity) -> str:
    unit = f" [{quantity.unit}]" if quantity.unit else ""
    default = "" if quantity.default is None else f"; by default {quantity.default:g}"
    return f"- `{quantity.name}`{unit}: {quantity.meaning}, {quantity.range}{default}"


def _toml(value: str | float) -> str:
    return f'"{value}"' if isinstance(value, str) else f"{value}"


def main(arguments: list[str]) -> int:
    """Write the page, or with ``--check`` compare it; return the exit code."""
    if arguments == ["--check"]:
        is_current = PAGE.is_file() and PAGE.read_text(encoding="utf-8") == page()
        if not is_current:
            print(f"{PAGE.name} is not what kinds.py says; run: python -m hil.faults.page", file=sys.stderr)
        return 0 if is_current else 1
    if arguments:
        print("usage: python -m hil.faults.page [--check]", file=sys.stderr)
        return 2
    PAGE.write_text(page(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
