"""The ROS 2 package: colcon builds it, ROS's linters find nothing, and what its files name is there."""

import importlib.metadata
import itertools
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest
import yaml

from hil.addons.report.robot_frames import ODOM, ROBOT_TOPIC
from hil.addons.ros2.settings import Settings
from tests.support.processes import environment, hil_process
from tools.build import ros_package

MISSING = "colcon and the linters of ROS 2 are not installed; run: make setup EXTRAS=[dev]"
catkin_pkg = pytest.importorskip("catkin_pkg.package", reason=MISSING)
PROGRAMS = Path(sys.executable).parent


def run(*command: str | Path, cwd: Path, env: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*map(str, command)], cwd=cwd, env=env, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return ros_package.build(tmp_path_factory.mktemp("ros"))


@pytest.fixture(scope="module")
def installed(package: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the package with colcon in a workspace, and return where it is installed."""
    workspace = tmp_path_factory.mktemp("workspace")
    shutil.copytree(package, workspace / "src" / package.name)
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("AMENT", "COLCON", "PYTHON"))}
    clean |= {"PATH": f"{PROGRAMS}{os.pathsep}{os.environ['PATH']}", "HOME": str(workspace)}
    done = run(PROGRAMS / "colcon", "build", cwd=workspace, env=clean)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"Finished <<< {package.name}" in done.stdout
    return workspace / "install" / package.name


def test_colcon_installs_every_file_where_ros_looks_for_it(package: Path, installed: Path) -> None:
    share = installed / "share" / package.name
    for name in ("package.xml", "README.md", "LICENSE", *(f"{folder}/*" for folder in ("launch", "config"))):
        files = sorted(package.glob(name))
        assert files
        for file in files:
            assert (share / file.relative_to(package)).read_bytes() == file.read_bytes()
    assert (installed / "share" / "ament_index" / "resource_index" / "packages" / package.name).is_file()
    modules = {file.name for file in installed.glob(f"lib/python*/site-packages/{package.name}/*.py")}
    assert modules == {file.name for file in (package / package.name).glob("*.py")}
    assert os.access(installed / "lib" / package.name / "mecanum_hil", os.X_OK)


def test_the_installed_node_is_hil_ros2(installed: Path) -> None:
    (site,) = installed.glob("lib/python*/site-packages")
    node = installed / "lib" / installed.name / "mecanum_hil"
    env = environment() | {"PYTHONPATH": str(site), "PATH": f"{PROGRAMS}{os.pathsep}{os.environ['PATH']}"}
    done = run(node, "--help", cwd=installed, env=env)
    told = hil_process("ros2", "--help")
    assert (done.returncode, done.stdout) == (told.returncode, told.stdout)
    done = run(node, "--help", cwd=installed, env=env | {"PATH": "/nowhere"})
    assert done.returncode == 1
    assert done.stderr.startswith("mecanum_hil: there is no command hil on the PATH; install mecanum-hil with pip")


def test_the_manifest_is_one_of_a_python_package_with_our_version(package: Path) -> None:
    warnings: list[str] = []
    manifest = catkin_pkg.parse_package(package, warnings=warnings)
    assert (manifest.name, manifest.version) == (package.name, importlib.metadata.version("mecanum-hil"))
    assert manifest.get_build_type() == "ament_python"
    assert not warnings


@pytest.mark.parametrize("linter", ["ament_flake8", "ament_pep257"])
def test_the_linters_of_ros_find_nothing(linter: str, package: Path) -> None:
    done = run(PROGRAMS / linter, package, cwd=package, env=environment())
    assert done.returncode == 0, done.stdout
    assert "launching.py" in done.stdout + done.stderr  # it looked at the files


def test_the_parameters_are_those_of_the_node_with_its_defaults(package: Path) -> None:
    given = yaml.safe_load((package / "config" / "params.yaml").read_text())["/**"]["ros__parameters"]
    made = Settings(**{name: tuple(v) if isinstance(v, list) else v for name, v in given.items()})
    assert made == Settings()
    assert set(made.__slots__) == set(given)


@pytest.mark.parametrize(
    ("file", "given", "words"),
    [
        ("simulation", {"rviz": "false"}, ["circle_speed", "--mode", "lockstep"]),
        (
            "robot",
            {"config": "my.toml", "allow_motion": "true", "port": "8770"},
            ["my.toml", "--mode", "realtime", "--port", "8770", "--allow-motion"],
        ),
    ],
    ids=["simulation", "robot"],
)
def test_the_launch_files_start_the_node_with_these_words(
    file: str, given: dict[str, str], words: list[str], installed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip(
        "launch_ros.actions", reason="ROS 2's launch system has no wheel; source an installation of ROS 2"
    )
    from launch import LaunchContext
    from launch.actions import OpaqueFunction
    from launch.launch_description_sources import get_launch_description_from_python_launch_file as read
    from launch.utilities import perform_substitutions

    monkeypatch.syspath_prepend(next(installed.glob("lib/python*/site-packages")))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(installed), prepend=os.pathsep)
    context = LaunchContext()
    context.launch_configurations.update(given)
    started = []
    for entity in read(str(installed / "share" / installed.name / "launch" / f"{file}.launch.py")).entities:
        done = entity.visit(context)
        started += done if isinstance(entity, OpaqueFunction) else []
    node = started[0]
    node._perform_substitutions(context)
    command = (perform_substitutions(context, part) for part in node.cmd)
    assert next(command) == str(installed / "lib" / installed.name / "mecanum_hil")
    assert list(itertools.takewhile("--ros-args".__ne__, command)) == words


def test_the_view_shows_the_frames_and_topics_that_there_are(package: Path) -> None:
    view = yaml.safe_load((package / "config" / "robot.rviz").read_text())["Visualization Manager"]
    assert view["Global Options"]["Fixed Frame"] == ODOM
    topics = {
        display["Name"]: display[key]["Value"]
        for display in view["Displays"]
        for key in ("Topic", "Description Topic")
        if key in display
    }
    assert topics == {"Robot": ROBOT_TOPIC.strip("/"), "Estimate": "odom", "Truth": "ground_truth/odom"}
