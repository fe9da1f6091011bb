"""Writes FAULTS.md, the page of all kinds of faults, from the tables in ``kinds`` and ``cases``.

``python -m hil.faults.page`` writes it, ``--check`` fails when it is not as it would be written.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

from hil.faults.cases import CASES, DURATION_S, PAIRS, Row
from hil.faults.kind import Kind, Quantity
from hil.faults.kinds import KINDS

PAGE = Path(__file__).with_name("FAULTS.md")

_INTRODUCTION = """\
# Faults

<!-- Written by python -m hil.faults.page from hil/faults/kinds.py and cases.py. -->

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
- Rows act in the order of the scenario, each on what the ones before it left. On a link this holds within each of two
  layers. Kinds of whole frames (all but `bit_errors`, `truncation` and `babble`, which spoil what is on the wire) come
  first on the way to the robot and last on the way from it, wherever their rows are. A frame that `reorder` held back
  meets the rows behind that row when it goes on. What `delay` and `jitter` hold is not overtaken: frames
  of other messages in the same direction wait behind it.
- Every row reports how often it was applied, in the figures (`fault`, key `applied`), the report and the recording.
  A row that was never applied fails the run: it has shown nothing.
- A fault that can take feedback, state or robot away explains the ticks in which the robot is not driven, and these do
  not count against `[allow]`: from the first tick at which the fault may have shown until the robot is driven again.
  After its window it may still show for as long as frames are on their way (`[link]`, and the value of a `delay` or
  `jitter`) and old feedback is fresh enough (`firmware.watchdog_s`). Which kinds can is said below; one that only
  changes how the robot moves, or what is recorded, explains nothing. Nothing explains a run in which the robot was
  never driven.
- STEP, STEP_DONE and HELLO are spared by all faults of the link: they carry no control.
- Faults of the device and of the plant act inside the virtual robot. One in another process (`hil device`) gets them
  through its truth socket, so `hil run` needs `--truth`; on a real board they are refused.
- No fault of a signal gets round the guard, and none arms the robot.

Another package adds kinds that act on signals or frames: each is a `hil.faults.kind.Kind` with its effect, registered
as an entry point of the group `hil.faults`.

`hil list faults` prints the kinds in short, and `hil catalogue` tries them all (see the end of this page).
"""

_CATALOGUE = f"""\
## The catalogue

`hil catalogue` puts every kind of fault into {DURATION_S:g} s of a circle, over memory, serial and CAN, and prints a
table with a row for each run; with exit code 1 where one is not as it should be.

    hil catalogue                               # every fault alone
    hil catalogue --pairs --realtime            # all pairs too, and a part of them in real time
    hil catalogue --pairs --sample 60 --seed 7  # 60 of the pairs; another seed takes others
    hil catalogue --law ./my_law.py:MyLaw       # your law on the same circle
    hil catalogue my_robot.toml --kind mute     # your scenario, one kind

Runs are in lockstep, so they are exact, and every run that can be recovered from is done twice: with
`loop.rearm = true`, and without. In each run this has to hold:

- **Safety.** A judge at the robot's end of the link sees every frame that the firmware is given, and decodes it by
  itself; and what crosses the plant port, in every tick of 1 ms: whether the drives are on, their torques and duties,
  the encoders' counts and the currents. Drives are on only with a command that is valid, fresh and of the session in
  force. Without one for the time of the watchdog, or after a stop, they are off within the ramp and 1 s, which means no
  torque and no duty. Until then no torque drives a wheel that turns faster than is asked, or than the ramp leaves, or
  the other way: not for more than 20 ms, where it is beyond by more than 1 rad/s and a tenth, for a speed loop may
  overshoot. What has stopped, or was reset, moves again only after an ARM with a new nonce. Numbers are finite. One law
  more is on the firmware's own account: the set points of its speed loops are never beyond the command, and go to zero
  within the ramp, and stay there (column `after silence`, the greatest that was seen from then on). At the end every
  robot is left alone, without a host, for watchdog, ramp and 1.1 s.
- **Outcome**, as in the table below. It *goes on*: it stays ACTIVE. It *re-arms*: it stops and is back by itself, or
  without `loop.rearm` the run ends with exit code 3 and a sentence that tells of `loop.rearm`. It *ends*: with exit
  code 3 and a sentence. A pair comes out as the worse of its two, but for those below the table. In real time a machine
  that stalls may stop any robot by its watchdog, so *re-arms* is as good there.
- **The cause.** Each sentence that tells why the robot was lost, and what ended the run, names the fault, or the stop
  that follows from it.
- **The fault was applied**, each of its rows that began before the run was over.
- **The fault explains** every tick in which the robot was not driven (`[allow]`), in lockstep.
- **The recording** opens again, with every row of the run, and with the fault and what ended the run as events.
- **The run ends.** After `--limit` seconds it is `hung`; a process that ends by itself is `crashed`; what was raised
  in another thread is `traceback`.

The recordings of runs that are not as they should be are kept in `runs/`. Kinds that act on the floor or the battery
set `plant.start.contact = "slip"` and `plant.start.drive = "current"` in the shipped plant.

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
    return "\n".join([_INTRODUCTION, *_sections(), _CATALOGUE + _cases()])


def _sections() -> Iterator[str]:
    for acts_on, title in _TITLES.items():
        kinds = [kind for kind in KINDS if kind.acts_on == acts_on]
        yield f"## {title}\n\n{_WORDS[acts_on]}"
        yield from map(_section, kinds)


def _cases() -> str:
    """Return the table of the catalogue's cases."""
    rows = ["| case | rows | outcome | in pairs | in real time |", "|---|---|---|---|---|"]
    for case in CASES:
        given = "; ".join(" ".join(_given(row)) for row in case.rows)
        marks = ("yes" if mark else "-" for mark in (case.in_pairs, case.realtime))
        rows.append(f"| {case.name} | {given} | {' | '.join([case.outcome, *marks])} |")
    rows += ["", "Pairs of which one keeps the other from coming out as it does alone:", ""]
    rows += ["| pair | outcome | why |", "|---|---|---|"]
    rows += [f"| {' + '.join(names)} | {pair.outcome} | {pair.why} |" for names, pair in PAIRS.items()]
    return "\n".join(rows) + "\n"


def _given(row: Row) -> Iterator[str]:
    """Yield what a case's row says, but for kind and target."""
    for key, value in row.items():
        if key not in ("kind", "target"):
            yield f"{key} = {value}"


def _section(kind: Kind) -> str:
    rows = [f"- target: {kind.target_words}"]
    rows += [_quantity(quantity) for quantity in (kind.value, *kind.further) if quantity is not None]
    if kind.is_instant:
        rows.append("- no `end_s`: it happens at `start_s`")
    rows.append(f"- applied counts: {kind.counts}")
    if kind.explains:
        where = "; of wheel speeds, `robot.*` and `truth.*` only" if kind.acts_on == "signal" else ""
        rows.append(f"- explains ticks in which the robot is not driven{where}")
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
