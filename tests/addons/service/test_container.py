"""The container's files: what they say of users, ports and places. `python -m tools.container` runs the Dockerfile."""

import json
from pathlib import Path

import yaml

from hil.addons.service.messages import HOST, ApiConfig
from tools.container.__main__ import DOCKERFILE, instructions

ROOT = Path(__file__).parents[3]
FOLDER = DOCKERFILE.parent


def test_the_image_runs_the_service_without_root_and_asks_for_its_health() -> None:
    steps = list(instructions(DOCKERFILE.read_text(encoding="utf-8")))
    last = steps[max(n for n, (name, _) in enumerate(steps) if name == "FROM") :]
    said = dict(last)
    assert (said["USER"], json.loads(said["CMD"])[:2]) == ("robot", ["hil", "serve"])
    assert json.loads(said["HEALTHCHECK"].partition("CMD ")[2]) == ["hil", "ctl", "status"]
    assert {name for name, _ in steps} & {"EXPOSE", "ADD", "ENTRYPOINT"} == set()
    user = [name for name, _ in last].index("USER")
    assert all("pip" not in words for name, words in last[user:] if name == "RUN"), "the user may not change what runs"


def test_joined_lines_are_one_instruction() -> None:
    assert list(instructions("# no\nFROM a AS b\n\nRUN one \\\n    && two\n")) == [
        ("FROM", "a AS b"),
        ("RUN", "one      && two"),
    ]


def test_all_of_compose_listens_on_the_loopback_alone() -> None:
    services = yaml.safe_load((FOLDER / "compose.yaml").read_text(encoding="utf-8"))["services"]
    assert services.keys() == {"robot", "metrics", "viewer"}
    for name, service in services.items():
        assert service["network_mode"] == "host", name
        assert "ports" not in service, name
        assert (service["cap_drop"], service["security_opt"]) == (["ALL"], ["no-new-privileges:true"]), name
    assert "--web.listen-address=127.0.0.1:9090" in services["metrics"]["command"]
    assert HOST == "127.0.0.1"


def test_prometheus_finds_the_service_its_token_and_the_alerts() -> None:
    metrics = yaml.safe_load((FOLDER / "prometheus.yml").read_text(encoding="utf-8"))
    [job] = metrics["scrape_configs"]
    port = ApiConfig.__dataclass_fields__["port"].default
    assert job["static_configs"] == [{"targets": [f"{HOST}:{port}"]}]
    assert job["authorization"]["credentials_file"] == f"/state/mecanum-hil/services/{port}.token"
    assert job["job_name"] == "robot", "as the alerts expect"
    services = yaml.safe_load((FOLDER / "compose.yaml").read_text(encoding="utf-8"))["services"]
    places = dict(volume.split(":")[:2] for volume in services["metrics"]["volumes"])
    assert places["state"] == "/state"
    for source, target in places.items():
        if source.startswith("."):
            assert (FOLDER / source).is_file(), source
            assert target.startswith("/etc/prometheus/")
