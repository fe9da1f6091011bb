"""A pytest plugin for runs that only ask whether anything fails: hypothesis does not look for a smaller example."""

import hypothesis
import pytest


def pytest_configure(config: pytest.Config) -> None:
    """Replace the profile that the tests' own configuration loaded before."""
    phases = (hypothesis.Phase.explicit, hypothesis.Phase.generate)
    hypothesis.settings.register_profile("first failure", deadline=None, derandomize=True, phases=phases)
    hypothesis.settings.load_profile("first failure")
