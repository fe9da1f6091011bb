"""What a scenario file is called that is a test: shared by who loads scenarios and who looks for tests."""

TEST_SUFFIX = ".hil.toml"
"""Ends the name of a file that pytest collects as a test. It is no part of the scenario's name."""
