"""Keys of runs: whatever decides a run changes its key, each thing by itself; nothing else does."""

import copy
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from shutil import copyfile
from typing import Any

import pytest

from hil.addons.batch import keys
from hil.addons.batch.keys import key_of, make_job
from hil.core.errors import BadInputError
from hil.plant import archive
from hil.scenario import Scenario, load
from hil.scenario.baseline import Band, Baseline
from hil.scenario.tables import Tables
from tests.support.outside import outside_package

OTHER_NAME = {
    "plant.fmu": "mecanum_fmi3",
    "controller.law": "afdsc",
    "reference.kind": "hold",
    "device.driver": "moteus",
}
"""Names that must exist."""
NOT_OF_A_RUN = ("service.",)
BASELINE = Baseline("circle_speed", "a", "lockstep", "linux", (1, 2), "b", {"steady_rms_m": Band(1.0, 2.0, 3.0)}, "one")


def rich() -> Scenario:
    """A scenario with something in each table."""
    faults = [{"kind": "slip_patch", "start_s": 0.1, "end_s": 0.3, "value": 0.1, "x_m": 0.1, "y_m": 0.2, "radius_m": 3}]
    faults += [{"kind": "burst_loss", "target": "command", "value": 0.1, "burst_frames": 3.0, "name": "bursts"}]
    sets: dict[str, Any] = {
        "controller.law": "dsc",
        "controller.gains.k1_1_s": 8.5,
        "device.driver": "odrive",
        "device.motors.node_ids": [0, 1, 2, 3],
        "link.url": "can:virtual/keys",
        "plant.start.mass_kg": 21.0,
        "plant.start.contact": "slip",
        "fault": faults,
        "expect": [{"signal": "error.planar_m", "from_s": 0.1, "to_s": 0.2, "above": -1.0, "below": 9.0}],
    }
    return replace(load("circle_speed", set=sets), baseline=BASELINE)


def other(key: str, value: Any) -> Any:
    if key in OTHER_NAME:
        return OTHER_NAME[key]
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value + 1 if math.isfinite(value) else 1.0
    if isinstance(value, str):
        return f"{value}x"
    return 1.5 if value is None else (*value, "one more")


def altered(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield each value below this one by its dotted key, and a copy of this one with that value changed alone."""
    if isinstance(value, Mapping):
        for name, one in value.items():
            yield from ((where, {**value, name: new}) for where, new in altered(one, f"{key}.{name}"))
        yield f"{key}.more", {**value, "more": 1.0}
    elif is_dataclass(value):
        for name in (field.name for field in fields(value) if field.init):
            for where, new in altered(getattr(value, name), f"{key}.{name}" if key else name):
                yield where, _with(value, name, new)
    elif isinstance(value, tuple) and value and is_dataclass(value[0]):
        for place, row in enumerate(value):
            for where, new in altered(row, f"{key}.{place}"):
                yield where, (*value[:place], new, *value[place + 1 :])
        yield f"{key}.left_out", value[1:]
        yield f"{key}.order", value[::-1] if len(value) > 1 else ()
    else:
        yield key, other(key, value)


def _with(value: Any, name: str, new: Any) -> Any:
    """Return a frozen dataclass with another value, also one that its checks would refuse."""
    changed = copy.copy(value)
    object.__setattr__(changed, name, new)
    return changed


def test_each_value_of_a_scenario_decides_its_key_and_its_place_and_the_service_do_not() -> None:
    scenario = rich()
    own = key_of(scenario)
    found: dict[str, str] = {}
    for name in Tables.__dataclass_fields__:
        for where, new in altered(getattr(scenario, name), name):
            found[where] = key_of(_with(scenario, name, new))
    same = {where for where, key in found.items() if key == own}
    assert same == {where for where in found if where.startswith(NOT_OF_A_RUN)} != set()
    changed = [key for where, key in found.items() if where not in same]
    assert len(set(changed)) == len(changed) - 1, "no two changes are alike, but for the one expectation left out twice"
    for elsewhere in ({"name": "other"}, {"path": Path("x.toml")}, {"directory": Path("x")}, {"provenance": {}}):
        assert key_of(replace(scenario, **elsewhere)) == own


def test_each_value_of_a_baseline_decides_a_key_and_its_file_does_not() -> None:
    scenario = rich()
    found = {where: key_of(replace(scenario, baseline=new)) for where, new in altered(BASELINE, "baseline")}
    own = key_of(scenario)
    assert [where for where, key in found.items() if key == own] == ["baseline.file"]
    assert key_of(replace(scenario, baseline=None)) not in {own, *found.values()}


def test_a_kind_its_options_and_each_version_decide_a_key(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = rich()
    jobs = [
        make_job(scenario),
        make_job(scenario, "module:function"),
        make_job(scenario, "module:function", {"a": 1}),
        make_job(scenario, options={"a": 1}),
        make_job(scenario, options={"a": 2}),
        make_job(scenario, scratch=Path("scratch"), signals=["loop.t_s"]),
        make_job(scenario, scratch=Path("scratch"), signals=["truth.x_m"]),
    ]
    assert [job.key for job in jobs] == [key_of(scenario, job.kind, job.options) for job in jobs]
    assert make_job(scenario, limit_s=1.0, record="always", recording="r", allow_motion=True).key == jobs[0].key
    assert jobs[-1].signals_file == str(Path("scratch") / f"{jobs[-1].key}.npz")
    found = {job.key for job in jobs}
    now = keys.versions()
    for name in now:
        with monkeypatch.context() as patched:
            patched.setattr(keys, "versions", lambda changed=name: now | {changed: "another"})
            found.add(key_of(scenario))
    assert len(found) == len(jobs) + len(now)


LAW = "class Law:\n    def reset(self, state, reference): ...\n"
LAW += "    def update(self, reference, state, applied, dt_s): ..."


def test_each_file_that_a_scenario_names_enters_by_its_bytes_and_not_its_folder(tmp_path: Path) -> None:
    files = {"plant.fmu": "plant.fmu", "reference.file": "way.csv", "device.motors.file": "motors.dbc", "law": "law.py"}
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        copyfile(archive.locate("mecanum", Path()), tmp_path / folder / "plant.fmu")
        (tmp_path / folder / "way.csv").write_text("x_m,y_m", encoding="utf-8")
        (tmp_path / folder / "motors.dbc").write_text("VERSION", encoding="utf-8")
        (tmp_path / folder / "law.py").write_text(LAW, encoding="utf-8")
    base = load("circle_speed")

    def at(folder: str, apart: str = "") -> Scenario:
        place = {name: str(tmp_path / ("two" if name == apart else folder) / file) for name, file in files.items()}
        return replace(
            base,
            plant=_with(base.plant, "fmu", place["plant.fmu"]),
            reference=replace(base.reference, options={"file": place["reference.file"]}),
            device=_with(base.device, "motors", {"file": place["device.motors.file"]}),
            controller=replace(base.controller, law=f"{place['law']}:Law"),
        )

    own = key_of(at("one"))
    assert key_of(at("two")) == own
    found = {own}
    for name, file in files.items():
        changed = tmp_path / "two" / file
        before = changed.read_bytes()
        changed.write_bytes(before + b"\n")
        found.add(key_of(at("one", apart=name)))
        changed.write_bytes(before)
        os.utime(changed, (1.0, 1.0))
        assert key_of(at("one", apart=name)) == own
    assert len(found) == 1 + len(files)
    (tmp_path / "two" / "way.csv").unlink()
    with pytest.raises(BadInputError, match=r"file .*way\.csv: it cannot be read \(No such file .*\); a run needs it"):
        key_of(at("two"))


def test_what_a_law_imports_from_its_folder_decides_a_key(tmp_path: Path) -> None:
    found = set()
    for number in (1, 2):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "tuning.py").write_text(f"K = {number}", encoding="utf-8")
        (folder / "law.py").write_text(f"{LAW}\n    import tuning", encoding="utf-8")
        found.add(key_of(load("circle_speed", set={"controller.law": str(folder / "law.py:Law")})))
    (folder / "law.py").write_text(f"{LAW}\n    import tuning  # longer", encoding="utf-8")
    found.add(key_of(load("circle_speed", set={"controller.law": str(folder / "law.py:Law")})))
    assert len(found) == 3


@pytest.mark.parametrize("key", ["robot.mass_kg", "reference.radius_m", "controller.gains.k1_1_s"])
def test_a_whole_number_has_the_key_of_the_float(key: str) -> None:
    whole, exact = (key_of(load("circle_speed", set={"controller.law": "dsc", key: one})) for one in (9, 9.0))
    assert whole == exact


@pytest.mark.parametrize(
    ("group", "key"), [("hil.references", "reference.kind"), ("hil.drivers", "device.driver")], ids=["way", "driver"]
)
def test_the_code_of_another_package_decides_a_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, group: str, key: str
) -> None:
    scenario, found = load("circle_speed"), set()
    table, name = key.split(".")
    for number in (1, 2):
        package = f"outside-{table}-{number}"
        outside_package(tmp_path, monkeypatch, f"K = {number}", {group: {"theirs": "theirs:It"}}, package, "theirs")
        found.add(key_of(_with(scenario, table, _with(getattr(scenario, table), name, "theirs"))))
    found.add(key_of(_with(scenario, table, _with(getattr(scenario, table), name, "theirs_too"))))
    assert len(found) == 3
