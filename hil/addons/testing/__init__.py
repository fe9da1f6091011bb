"""The pytest plugin, and the type of its fixture for annotations in a test suite.

The plugin, ``hil.addons.testing.plugin``, is installed with the package. It collects ``*.hil.toml`` files as
tests and has one fixture, of this type:

    def test_a_heavy_robot_still_tracks(hil_run: RunScenario) -> None:
        assert hil_run("paper_circle", set={"plant.start.mass_kg": 26.0}).metrics["tracked_s"] < 1.5

    def test_a_serial_line_changes_no_byte(hil_run: RunScenario) -> None:
        there, here = hil_run("paper_circle", link="serial:pty"), hil_run("paper_circle")
        assert there.metrics["wire_sha256"] == here.metrics["wire_sha256"]

hil/addons/testing/PYTEST.md documents all of it.
"""
