"""The rules by which C is mutated, and the tests that are near to each file of it."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from firmware_protocol.built import SOURCES as FIRMWARE
from hil.plant.built import SOURCES as SHIM
from plant_fmu.sources import MUJOCO_SOURCES, SOURCES
from tools.mutants import NEAR_S, ROOT, Mutant, Tests, batches

# What is generated is compared with what generates it.
_EVERY = dict.fromkeys(
    path.relative_to(ROOT).as_posix()
    for path in (*FIRMWARE, *SHIM, *SOURCES, *MUJOCO_SOURCES)
    if path.parent.name != "generated"
)
PLACES = {Path(file).name: file for file in _EVERY}
"""Every file whose mutants are tried, by name."""


def _of(room: str, *names: str) -> tuple[str, ...]:
    return tuple(f"tests/{room}/test_{name}.py" for name in names)


# The fastest and the ones that find most first.
_OF_THE_NODE = _of(
    "firmware_protocol",
    *("node_sessions", "node_states", "node_thresholds", "node_faults", "node", "node_feedback", "node_replay"),
    *("parameters", "stored_parameters"),
)
_OF_PARAMETERS = _of("firmware_protocol", "parameters", "stored_parameters")
_OF_THE_CLIENT = _of("firmware_protocol", "client_frames", "client")
_OF_CALLS = _of("firmware_protocol", "wheel_module")
_OF_FORCES = _of("plant_fmu", "plant_lifted", "plant_friction", "plant_slip", "plant_reference", "plant_equations")
_OF_CALLS_OF_FMI = _of("plant_fmu", "fmi2_calls", "plant_state", "fmi3_calls", "fmu_calls")
RULED = {
    **dict.fromkeys(("states.c", "receive.c", "supervise.c", "node.c"), _OF_THE_NODE),
    **dict.fromkeys(("arming.c", "session.c"), (*_OF_THE_CLIENT, *_of("robot", "snapshot"))),
    "incoming.c": (*_of("robot", "snapshot"), *_OF_THE_CLIENT, *_of("firmware_protocol", "snapshot_twin")),
    "service.c": (*_OF_PARAMETERS, *_of("firmware_protocol", "node_feedback", "protocol_rules")),
    "control.c": (*_of("firmware_protocol", "wheel_loops", "node_thresholds"), *_OF_THE_NODE),
    "feedback.c": (*_of("firmware_protocol", "node_feedback", "node_means"), *_OF_THE_NODE[:5]),
    "parameters.c": (*_OF_PARAMETERS, *_of("firmware_protocol", "node")),
    **dict.fromkeys(("line.c", "framing.c", "cobs.c", "crc.c"), _of("firmware_protocol", "line_of_the_library")),
}
"""The near tests of each file that carries out rules of the protocol."""
_NEAR = RULED | {
    "load.c": _of("wire", "statistics"),
    "motion.c": (*_of("firmware_protocol", "wheel_motion"), *_of("robot", "latency")),
    "timing.c": (*_of("firmware_protocol", "wheel_timing"), *_of("robot", "latency", "freshness", "link_times")),
    "direct.c": (*_OF_CALLS, *_of("robot", "direct")),
    "host.c": _of("firmware_protocol", "node_feedback", "stored_parameters", "node", "plant_port", "client"),
    "module.c": (*_OF_CALLS, *_of("core", "model"), *_of("firmware_protocol", "codec", "framing")),
    "session_types.c": (*_OF_CALLS, *_of("robot", "direct"), *_OF_THE_CLIENT),
    "terminal.c": _of("wire", "terminal", "pty_line", "serial_ports"),
    "timing_types.c": (*_of("wire", "statistics"), *_of("robot", "latency", "freshness"), *_OF_CALLS),
    "value_types.c": (*_OF_CALLS, *_of("runtime", "row", "tick_calls"), *_of("laws", "afdsc_tables")),
    "remote.c": _of("plant", "plant_shim", "remote_plant"),
    "robot_faults.c": _of("robot", "robot_faults", "wiring", "reset_told", "robot_limits"),
    "windows.c": _of("plant", "window_stepper"),
    **dict.fromkeys(
        ("cosim.c", "callbacks.c", "derive.c"),
        _of("plant", "window_stepper", "plant_start", "plant_shim", "plant_start_types", "units", "foreign_fmu"),
    ),
    **dict.fromkeys(
        ("contact.c", "friction.c", "mecanum.c", "mecanum_physics.c", "model.c"),
        (*_OF_FORCES, *_of("plant_fmu", "plant_energy", "plant_state", "three_plants")),
    ),
    "tip.c": _of("plant_fmu", "plant_tips"),
    "motor.c": (*_of("plant_fmu", "plant_motors"), *_OF_FORCES),
    "sensors.c": (*_of("plant_fmu", "plant_sensors"), *_OF_FORCES),
    **dict.fromkeys(("instance.c", "saved_state.c"), (*_OF_CALLS_OF_FMI, *_OF_FORCES)),
    **dict.fromkeys(("fmi2.c", "fmi2_unclaimed.c", "fmi3.c", "fmi3_unclaimed.c"), _OF_CALLS_OF_FMI),
    **dict.fromkeys(("physics.c", "robot.c"), _of("plant_fmu", "mujoco_motion", "mujoco_model", "mujoco_fmu")),
}
_ROOM_S = 60.0

_SWAPS = {
    "<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==", "&&": "||", "||": "&&", "+": "-", "-": "+",
    "*": "/", "/": "*", "&": "|", "|": "&", "<<": ">>", ">>": "<<", "+=": "-=", "-=": "+=", "*=": "/=", "/=": "*=",
    "|=": "&=", "&=": "|=", "++": "--", "--": "++", "true": "false", "false": "true",
}  # fmt: skip
_AXES = {"x": "y", "vx": "vy", "fl": "fr", "rl": "rr", "sin": "cos", "left": "forward"}
_AXES |= {two: one for one, two in _AXES.items()}
_AXES |= {one.upper(): two.upper() for one, two in _AXES.items()}
_OPERATOR = re.compile(
    r"(?<= )(?:<<|>>|[<>=!]=|&&|\|\||[-+*/|&]=|[-+*/|&<>])(?= )|(?<=\w)(?:\+\+|--)|\b(?:true|false)\b"
)
_UNARY = re.compile(r"(?:(?<=[=(?:,*/+-] )|(?<=\()|(?<=return ))-(?=[\w(])|(?:(?<=[=&|] )|(?<=return ))!(?=[\w(])")
_WHOLE = re.compile(r"(?<![\w.])(?<!\de-)(\d+)(u?l{0,2})(?![\w.])")
_DECLARED = re.compile(r"\b(?!return\b|sizeof\b)\w+ \w+\[$")
_REAL = re.compile(r"(?<![\w.])(\d+\.\d+(?:e-?\d+)?|\d+e-?\d+)(f?)(?!\w)")
_CONDITION = re.compile(r"\bif \((.*)\) \{$")
_STATEMENT = re.compile(
    r"^\s+(?!\s|\(void\)\w+;|return\b.*\S;|const |static |wp_|float |double |bool |void \*\w+;|uint\w+ |wheel_\w+ \w+;)"
    r"[^{}]*;\s*$"
)
_ROW = re.compile(r"^\s+\{WP_STATE_\w+, WHEEL_EVENT_\w+, (WP_STATE_\w+)\},$")
_FUNCTION = re.compile(r"^(?:static )?\w+ \**(\w+)\([^;]*?\) \{$|^const \w+ (\w+)\[\w+\] = \{$", re.MULTILINE)
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_WORDS = re.compile(r'"(?:[^"\\\n]|\\.)*"')
# Not where the order means nothing.
_LISTED = re.compile(r"\b(?!(?:if|for|while|switch|sizeof|return|fmin|fmax|hypot)\b)\w+\(|(?:\)|= |, |^\s+)\{")


def changes(line: str) -> Iterator[tuple[str, str]]:
    """Yield every rule that applies to a line of C without comments, and what it makes of the line."""
    plain = _WORDS.sub(lambda found: " " * len(found[0]), line)
    for found in _OPERATOR.finditer(plain):
        rule = "sign" if found[0][0] in "+-*/" else "logic" if found[0][0] in "&|tf" else "comparison"
        yield rule, line[: found.start()] + _SWAPS[found[0]] + line[found.end() :]
    for found in _UNARY.finditer(plain):
        yield "sign", line[: found.start()] + line[found.end() :]
    for found in _WHOLE.finditer(plain):
        before, behind = line[: found.start()], line[found.end() :]
        others = {int(found[1]) + 1, max(int(found[1]) - 1, 0)} - {int(found[1])}
        if _DECLARED.search(before) or behind.startswith("]){"):
            # An array may be larger; of a parameter the size means nothing in C.
            others = set() if behind[1:2] in (",", ")") and not behind.startswith("]){") else {min(others)}
        yield from (("constant", f"{before}{whole}{found[2]}{behind}") for whole in sorted(others))
    for found in _REAL.finditer(plain):
        for factor in (0.75, 1.25):
            real = float(found[1])
            other = real * factor if real else factor - 1
            yield "constant", f"{line[: found.start()]}{other}{found[2]}{line[found.end() :]}"
    for found in re.finditer(r"\b[A-Za-z]\w*\b", plain):
        other_name = "_".join(_AXES.get(word, word) for word in found[0].split("_"))
        if other_name != found[0]:
            yield "axis", line[: found.start()] + other_name + line[found.end() :]
    yield from (("arguments", other) for other in _exchanged(line, plain))
    if found_condition := _CONDITION.search(plain):
        start, end = found_condition.span(1)
        yield "logic", f"{line[:start]}!({line[start:end]}){line[end:]}"
    if row := _ROW.match(plain):
        yield "row", line[: row.start(1)] + "WP_STATE_ACTIVE" + line[row.end(1) :]
        yield "row", "    {WP_STATE_BOOT, WHEEL_EVENT_READY, WP_STATE_IDLE},"
    elif _STATEMENT.match(line):
        yield "statement left out", ";"


def _exchanged(line: str, plain: str) -> Iterator[str]:
    """Yield the line with each two neighbours exchanged, of the arguments of a call or the members of a list."""
    if not plain.startswith(" "):
        return
    for opened in _LISTED.finditer(plain):
        ends, depth = [opened.end()], 0
        for place in range(opened.end(), len(plain)):
            depth += (plain[place] in "([{") - (plain[place] in ")]}")
            if depth < 0 or (depth == 0 and plain[place] == ","):
                ends.append(place)
            if depth < 0:
                break
        for start, middle, end in zip(ends, ends[1:], ends[2:], strict=False):
            first, second = line[start:middle].lstrip(", "), line[middle + 1 : end].strip()
            if second and first != second and not second.startswith("."):
                begin = middle - len(first)
                yield f"{line[:begin]}{second}, {first}{line[end:]}"


def mutants(file: str, text: str) -> list[Mutant]:
    """Return every mutant of a C file; what runs no code has none: comments, words, includes, static assertions."""
    code = _COMMENT.sub(lambda found: re.sub(r"[^\n]", " ", found[0]), text)
    made: dict[tuple[int, str], Mutant] = {}
    start = 0
    for number, (whole, bare) in enumerate(zip(text.splitlines(), code.splitlines(), strict=True), start=1):
        end = start + len(whole.encode())
        begin = end - len(whole.lstrip().encode())
        start = end + 1
        if bare.strip() and not bare.startswith(("#include", "_Static_assert")):
            for rule, after in changes(bare.rstrip()):
                if after.strip() != bare.strip():
                    mutant = Mutant(file, number, rule, begin, end, whole.strip(), after.strip())
                    made.setdefault((number, mutant.after), mutant)
    return list(made.values())


def functions(name: str) -> list[str]:
    """Return the names of a file's functions and tables."""
    found = _FUNCTION.finditer((ROOT / PLACES[name]).read_text(encoding="utf-8"))
    return [one[1] or one[2] for one in found]


def near_tests(mutant: Mutant, seconds: Mapping[str, float]) -> Iterator[Tests]:
    """Yield the tests to run for a mutant, in turn: those of its file, the quickest first; then its room."""
    files = list(dict.fromkeys(_NEAR[Path(mutant.file).name]))
    by_time = sorted(seconds, key=seconds.__getitem__)
    quickest = [test for file in files for test in by_time if test.partition("::")[0] == file]
    yield from batches(quickest, seconds) if quickest else [Tests(files, None, NEAR_S)]
    room = {"hil/plant": "tests/plant", "plant_fmu/mujoco": "tests/plant_fmu"}.get(mutant.room)
    yield Tests([room or f"tests/{mutant.room.split('/')[0]}"], None, _ROOM_S, slow=True)
