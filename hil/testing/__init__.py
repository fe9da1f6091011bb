"""Hardware in the loop in a test suite: what the pytest plugin gives to tests, with its types.

The plugin, ``hil.cli.pytest_plugin``, is installed with the package. It collects ``*.hil.toml`` files and has three
fixtures, of these types:

    def test_a_heavy_robot_still_tracks(hil_run: RunScenario) -> None:
        assert hil_run("paper_circle", set={"plant.start.mass_kg": 26.0}).metrics["tracked_s"] < 1.5

    def test_the_robot_says_hello(virtual_robot: StartRobot, hil_link: OpenLink) -> None:
        link = hil_link(virtual_robot("paper_circle"))
        assert link.ask(HelloRequest(PROTOCOL_VERSION), HelloIdentity).schema_hash == SCHEMA_HASH

hil/testing/PYTEST.md has the whole story. Nothing heavy is imported before a fixture is used.
"""

from hil.testing.fixtures import OpenLink, RunScenario, StartRobot
from hil.testing.robot_link import RobotLink
from hil.testing.robot_process import RobotProcess

__all__ = ["OpenLink", "RobotLink", "RobotProcess", "RunScenario", "StartRobot"]
