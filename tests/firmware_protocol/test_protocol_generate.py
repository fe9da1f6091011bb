"""The generator: the committed files match wheel.dbc, and features that the codecs lack are refused."""

import re
from pathlib import Path

import pytest

from firmware_protocol import generate
from firmware_protocol.generated.messages import SCHEMA_HASH, WheelCommand
from firmware_protocol.schema import SchemaError, read_schema
from tests.support.protocol_cases import PROTOCOL, vectors

DBC = (PROTOCOL / "wheel.dbc").read_text(encoding="utf-8")
FL = 'SG_ fl_rad_s : 0|13@1- (0.015625,0) [-63.984375|63.984375] "rad/s" ROBOT'
NEXT = "BO_ 64 WHEEL_COMMAND"


def edited(tmp_path: Path, old: str, new: str) -> Path:
    """Write wheel.dbc with one passage, which must be there, replaced."""
    assert old in DBC
    path = tmp_path / "wheel.dbc"
    path.write_text(DBC.replace(old, new), encoding="utf-8")
    return path


def test_the_generated_files_are_fresh(capsys: pytest.CaptureFixture[str]) -> None:
    assert generate.main(["--check"]) == 0, capsys.readouterr().out


def test_check_names_the_stale_files_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "firmware_protocol"
    root.mkdir()
    (root / "wheel.dbc").write_text(DBC, encoding="utf-8")
    part = "<!-- generated -->\n<!-- /generated -->\n"
    (root / "PROTOCOL.md").write_text(f"before\n{part}between\n{part}{part}after\n", encoding="utf-8")
    monkeypatch.setattr(generate, "ROOT", root)
    assert generate.main([]) == 0
    assert generate.main(["--check"]) == 0
    document = (root / "PROTOCOL.md").read_text(encoding="utf-8")
    assert document.startswith("before\n")
    assert "\nbetween\n" in document
    assert document.endswith("\nafter\n")
    for name in ("messages.py", "wheel_messages.c"):
        (root / "generated" / name).write_text("stale", encoding="utf-8")
    capsys.readouterr()
    assert generate.main(["--check"]) == 1
    printed = capsys.readouterr().out
    assert re.findall(r"^stale: firmware_protocol.generated.(\S+);", printed, flags=re.MULTILINE) == [
        "messages.py",
        "wheel_messages.c",
    ]
    assert (root / "generated" / "messages.py").read_text(encoding="utf-8") == "stale"


def test_what_is_not_supported_is_one_line_and_exit_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    edited(tmp_path, FL, FL.replace("0.015625,0", "0.01,0"))
    monkeypatch.setattr(generate, "ROOT", tmp_path)
    assert generate.main([]) == 2
    printed = capsys.readouterr().err
    assert printed.startswith("wheel.dbc: WHEEL_COMMAND.fl_rad_s: scale 0.01 is not a power of two")
    assert printed.count("\n") == 1
    assert not (tmp_path / "generated").exists()


def test_a_document_without_markers_is_refused(tmp_path: Path) -> None:
    (tmp_path / "PROTOCOL.md").write_text("no markers", encoding="utf-8")
    said = "expected <!-- generated --> and <!-- /generated --> around its load table, parameters, messages"
    with pytest.raises(SchemaError, match=f"^PROTOCOL.md: {said}$"):
        generate.outputs(read_schema(PROTOCOL / "wheel.dbc"), tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("SG_ source : 0|8@1+", "SG_ source : 7|8@0+", r"ESTOP.source: expected little-endian"),
        (FL, FL.replace("0.015625,0", "0.015625,1"), r"WHEEL_COMMAND.fl_rad_s: .*offset 0"),
        (FL, FL.replace("0.015625,0", "0.02,0"), r"WHEEL_COMMAND.fl_rad_s: scale 0.02 is not a power of two"),
        (FL, FL.replace("0.015625,0", "1,0"), r"WHEEL_COMMAND.fl_rad_s: expected an unsigned integer"),
        (FL, FL.replace("0|13", "0|12"), r"fl_rad_s: limits \[-63.98.*\|63.98.*\] are not raw values of 12 bits"),
        (FL, FL.replace("[-63.984375|63.984375]", "[-64.1|63]"), r"fl_rad_s: limits \[-64.1\|63\] are not raw .* 13 b"),
        (FL, FL.replace("[-63.984375|63.984375]", "[0|0]"), r"fl_rad_s: give its limits as \[minimum\|maximum\]"),
        (NEXT, f'BO_ 1 A: 4 HOST\n SG_ a : 0|25@1- (0.5,0) [0|1] "" ROBOT\n\n{NEXT}', r"A.a: 25 bits, at most 24 are"),
        (NEXT, f'BO_ 1 A: 5 HOST\n SG_ a : 0|33@1+ (1,0) [0|1] "" ROBOT\n\n{NEXT}', r"A.a: 33 bits, at most 32 are"),
        (NEXT, "BU_ 64 WHEEL_COMMAND", r'wheel.dbc: DBC: "Invalid syntax at line \d+, column 5'),
        (FL, FL.replace("fl_rad_s", "count"), r"WHEEL_COMMAND.count: the name is taken"),
        (FL, FL.replace("fl_rad_s", "double"), r"WHEEL_COMMAND.double: the name is taken"),
        ("SG_ substeps : 32|16", "SG_ substeps : 31|16", r"overlapping in message STEP"),
        ("SG_ substeps : 32|16", "SG_ substeps : 33|15", r"STEP.substeps starts at bit 33, expected 32"),
        ("BO_ 768 STEP: 6", "BO_ 768 STEP: 7", r"STEP: its signals end at bit 48, its payload at bit 56"),
        ("SG_ substeps : 32|16", "SG_ substeps M : 32|16", r"STEP: .*no multiplexing"),
        ("BO_ 768 STEP", "BO_ 2147484416 STEP", r"STEP: expected an 11-bit id"),
        ('VAL_ 128 state 0 "BOOT"', 'VAL_ 128 state 0 "START"', r"STATUS.state: its VAL_ table differs"),
        ('VAL_ 32 request 0 "IDLE"', "VAL_ 32 request", r"request: VAL_ must name every value"),
        ("SG_ pages : 8|8", "SG_ page_count : 8|8", r"id 0x701: its layout is frozen"),
        ('VERSION "2"', 'VERSION ""', r'VERSION "": expected a number from 1 to 255'),
        ('VERSION "2"', 'VERSION "256"', r'VERSION "256": expected a number from 1 to 255'),
    ],
)  # fmt: skip
def test_what_the_codecs_do_not_support_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(SchemaError, match=message):
        read_schema(edited(tmp_path, old, new))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "ramp_s"', 'name = "watchdog_s"', r"'watchdog_s': expected a name of its own"),
        ('name = "ramp_s"', 'name = "Ramp"', r"'Ramp': expected a name of its own in lower case"),
        ('type = "UINT32"', 'type = "INT8"', r"counts_per_revolution: type 'INT8'; expected UINT32 or FLOAT32"),
        ("maximum = 32768", "maximum = 33554432", r"counts_per_revolution: a range from 4 to 33554432 cannot be"),
        (
            "minimum = 0.02\nmaximum = 0.1",
            "minimum = 0.2\nmaximum = 0.1",
            r"watchdog_s: a range from 0.2 to 0.1",
        ),
        ('meaning = "between two snapshots"', "", r"expected rows \[\[parameter\]\] of five keys"),
        ("[[parameter]]", "[[parameter", r"expected rows"),
    ],
)
def test_parameters_that_cannot_be_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = (PROTOCOL / "parameters.toml").read_text(encoding="utf-8")
    path = tmp_path / "parameters.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    assert path.read_text(encoding="utf-8") != text
    with pytest.raises(SchemaError, match=rf"^parameters\.toml: .*{message}"):
        read_schema(PROTOCOL / "wheel.dbc", path)


@pytest.mark.proves("R-HASH-1")
@pytest.mark.parametrize(("old", "new"), [('"ramp_s"', '"slope_s"'), ("maximum = 2\n", "maximum = 3\n")])
def test_the_parameters_are_part_of_the_schema_hash(tmp_path: Path, old: str, new: str) -> None:
    path = tmp_path / "parameters.toml"
    path.write_text((PROTOCOL / "parameters.toml").read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    changed = read_schema(PROTOCOL / "wheel.dbc", path)
    assert changed.hash() != SCHEMA_HASH
    assert changed.parameter_table_hash() != read_schema(PROTOCOL / "wheel.dbc").parameter_table_hash()


@pytest.mark.proves("R-HASH-1", "R-HASH-2")
@pytest.mark.parametrize(
    ("old", "new", "changes"),
    [
        ('CM_ BO_ 16 "Stop driving', 'CM_ BO_ 16 "Halt', False),
        ('VERSION "2"', 'VERSION "3"', False),
        ("BU_: HOST ROBOT", "BU_: ROBOT HOST", False),
        (FL, FL.replace("[-63.984375|", "[-63.96875|"), True),
        (FL, FL.replace("0.015625,0) [-63.984375|63.984375]", "0.0078125,0) [-31.9921875|31.9921875]"), True),
        (FL, FL.replace("rad/s", "1/s"), True),
        (FL, FL.replace("fl_rad_s", "left_rad_s"), True),
        ("BO_ 256 STATUS", "BO_ 299 STATUS", True),
        ('2 "OVERSPEED"', '2 "TOO_FAST"', True),
    ],
)
def test_the_schema_hash_covers_meaning_and_nothing_else(tmp_path: Path, old: str, new: str, changes: bool) -> None:
    path = edited(tmp_path, old, new)
    if "STATUS" in old:  # comments and value tables follow the id
        text = path.read_text(encoding="utf-8")
        path.write_text(
            re.sub(r'^(VAL_|CM_ BO_|CM_ SG_|BA_ "Rate" BO_) 256 ', r"\1 299 ", text, flags=re.MULTILINE),
            encoding="utf-8",
        )
    assert (read_schema(path).hash() != SCHEMA_HASH) == changes


@pytest.mark.proves("R-HASH-1")
def test_the_canonical_list_is_what_the_document_shows() -> None:
    canonical = read_schema(PROTOCOL / "wheel.dbc").canonical()
    document = (PROTOCOL / "PROTOCOL.md").read_text(encoding="utf-8")
    assert canonical.startswith("framing 1\nmessage 16 ESTOP 2\n")
    shown = re.findall(r"```text canonical\n(.*?)```", document, flags=re.DOTALL)
    assert len(shown) == 3
    assert all(part in canonical for part in shown)


@pytest.mark.proves("R-SER-2")
def test_the_worked_example_is_a_golden_vector() -> None:
    document = (PROTOCOL / "PROTOCOL.md").read_text(encoding="utf-8")
    (vector,) = (v for v in vectors() if isinstance(v.message, WheelCommand) and v.message.fl_rad_s == 1.5)
    assert f"on the wire  {vector.serial.hex(' ')}\n" in document
    assert f"payload      {vector.frame.payload.hex(' ')}\n" in document
