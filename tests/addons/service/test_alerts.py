"""The alerts for Prometheus: its own tool takes them, they fire when they should, and each metric in them is told."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from hil.addons.service import logs
from tests.support.processes import wait_for
from tests.support.service_testbed import ControlSide

ALERTS = Path(logs.__file__).with_name("alerts.yml")
CASES = Path(__file__).with_name("alerts_test.yml")


@pytest.mark.skipif(shutil.which("promtool") is None, reason="no promtool: it is in Debian's package prometheus")
def test_promtool_takes_the_alerts_and_they_fire_when_they_should(tmp_path: Path) -> None:
    for file in (ALERTS, CASES):
        shutil.copy(file, tmp_path)
    for words in (["check", "rules", ALERTS.name], ["test", "rules", CASES.name]):
        done = subprocess.run(["promtool", *words], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr


def test_each_metric_of_an_alert_is_one_that_a_service_tells(side: ControlSide) -> None:
    side.request("POST", "/v1/arm")
    wait_for(lambda: "hil_phase" in side.request("GET", "/metrics").text)
    told = side.request("GET", "/metrics").text
    rules = ALERTS.read_text(encoding="utf-8")
    named = {word for rule in re.findall("expr: (.*)", rules) for word in re.findall(r"\bhil_\w+", rule)}
    assert len(named) > 10
    assert {name for name in named if not re.search(rf"\b{name}\b", told)} == set()


def test_each_alert_has_a_case() -> None:
    alerts = re.findall(r"alert: (\w+)", ALERTS.read_text(encoding="utf-8"))
    cases = CASES.read_text(encoding="utf-8")
    assert len(alerts) == 12
    for alert in alerts:
        assert f"alertname: {alert}" in cases, f"{alert} must be silent"
        assert f'alertname="{alert}"' in cases, f"{alert} must fire"
