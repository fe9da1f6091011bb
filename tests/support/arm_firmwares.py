"""The STM32F405 firmwares, each built once for all tests that look at them."""

import functools
import shutil
from pathlib import Path

import pytest

from firmware_protocol.arm_build import Built, Target, build
from tests.support import once


def need_gcc() -> None:
    """Skip the test where the compiler is missing."""
    if shutil.which("arm-none-eabi-gcc") is None:
        pytest.skip("no arm-none-eabi-gcc: install gcc-arm-none-eabi")


def firmware(variant: str, board: str, link: str) -> Built:
    """Return a firmware that gcc has built."""
    need_gcc()
    target = Target(variant, board, link)
    return once.made(target.name, functools.partial(_build, target))


def _build(target: Target, folder: Path) -> Built:
    return build(target, folder, folder.parent / "objects")
