"""A plugin of pytest that puts a mutant into the runs of a file of tests. Only ``hil verify`` names it, with ``-p``."""

import argparse

import pytest

from hil.addons.verify.mutation.mutant import from_text
from hil.runtime.run_options import RunOptions

OPTION = "--hil-mutant"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(OPTION, help=argparse.SUPPRESS)


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(_Mutated(config.getoption(OPTION)))


class _Mutated:
    def __init__(self, text: str) -> None:
        self._mutant = from_text(text)

    @pytest.hookimpl(optionalhook=True)
    def pytest_hil_run_options(self, options: RunOptions) -> RunOptions:
        return self._mutant.put_into(options)
