"""A pytest plugin for runs that only ask whether anything fails: hypothesis does not look for a smaller example.

A run that takes more than ``TOOLS_PROCESSOR_S`` seconds of the processor is ended, as in an endless loop; where the
system knows no such limit it goes on.
"""

import contextlib
import os

import hypothesis
import pytest

PROCESSOR_S = "TOOLS_PROCESSOR_S"


def pytest_configure(config: pytest.Config) -> None:
    """Replace the profile that the tests' own configuration loaded before."""
    phases = (hypothesis.Phase.explicit, hypothesis.Phase.generate)
    hypothesis.settings.register_profile("first failure", deadline=None, derandomize=True, phases=phases)
    hypothesis.settings.load_profile("first failure")
    limit_processor(os.environ.get(PROCESSOR_S))


def limit_processor(limit_s: str | None) -> None:
    """End this process after seconds of the processor, if any are given and the system knows such a limit."""
    if limit_s:
        with contextlib.suppress(ImportError):
            import resource

            resource.setrlimit(resource.RLIMIT_CPU, (int(limit_s), int(limit_s)))
