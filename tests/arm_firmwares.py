"""The STM32F405 firmwares, each built once for all tests that look at them."""

import functools
import shutil
import tempfile
from pathlib import Path

import pytest

from firmware_protocol.arm_build import Built, Target, build


@functools.cache
def _folder() -> tempfile.TemporaryDirectory:
    return tempfile.TemporaryDirectory()


@functools.cache
def _build(target: Target) -> Built:
    return build(target, Path(_folder().name))


def need_gcc() -> None:
    """Skip the test where the compiler is missing."""
    if shutil.which("arm-none-eabi-gcc") is None:
        pytest.skip("no arm-none-eabi-gcc: install gcc-arm-none-eabi")


def firmware(variant: str, board: str, link: str) -> Built:
    """Return a firmware that gcc has built."""
    need_gcc()
    return _build(Target(variant, board, link))
