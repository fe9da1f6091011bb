"""The types of the pytest plugin's fixtures, for annotations in a test suite.

The plugin, ``hil.cli.pytest_plugin``, is installed with the package. It collects ``*.hil.toml`` files as tests and has
three fixtures, of these types:

    def test_a_heavy_robot_still_tracks(hil_run: RunScenario) -> None:
        assert hil_run("paper_circle", set={"plant.start.mass_kg": 26.0}).metrics["tracked_s"] < 1.5

    def test_the_robot_says_hello(virtual_robot: StartRobot, hil_link: OpenLink) -> None:
        link = hil_link(virtual_robot("paper_circle"))
        assert link.ask(HelloRequest(PROTOCOL_VERSION), HelloIdentity).schema_hash == SCHEMA_HASH

hil/cli/testing/PYTEST.md documents all of it.
"""

from hil.cli.testing.fixtures import OpenLink, RunScenario, StartRobot
from hil.cli.testing.robot import RobotLink, RobotProcess

__all__ = ["OpenLink", "RobotLink", "RobotProcess", "RunScenario", "StartRobot"]
