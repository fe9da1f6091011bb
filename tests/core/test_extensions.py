"""Parts that this package registers as entry points: they come first, and are left out with their add-on."""

from collections.abc import Callable

import pytest

from hil.core import extensions
from hil.core.errors import BadInputError
from hil.core.extensions import Extensions
from hil.robot.driver_registry import driver_names
from hil.scenario import load

DRIVERS = Extensions("hil.drivers", ("stm32",))


@pytest.fixture
def without_motors(monkeypatch: pytest.MonkeyPatch) -> None:
    is_installed: Callable[[str], bool] = extensions.is_installed
    monkeypatch.setattr(
        extensions, "is_installed", lambda place: not place.startswith("hil.addons.motors") and is_installed(place)
    )


def test_what_this_package_registers_is_shipped() -> None:
    assert DRIVERS.is_shipped("odrive")
    assert [name for name in ("stm32", "odrive", "unknown") if name in DRIVERS] == ["stm32", "odrive"]
    assert DRIVERS.shipped[0] == "stm32"
    assert DRIVERS.load("odrive", "x").title == "ODrive"
    assert DRIVERS.module("odrive") is None
    assert not [row for row in DRIVERS.lines() if row[0] == "odrive"]


def test_an_addon_that_is_not_installed_takes_its_parts_along(without_motors: None) -> None:
    assert not DRIVERS.is_shipped("odrive")
    assert "odrive" not in DRIVERS
    assert "odrive" not in driver_names()
    with pytest.raises(BadInputError, match=r"it belongs to hil\.addons\.motors, which is not installed; reinstall"):
        DRIVERS.load("odrive", "x")
    with pytest.raises(BadInputError, match=r"device\.driver = .odrive.; it belongs to hil\.addons\.motors"):
        load("paper_circle", set={"device.driver": "odrive"})
    load("paper_circle")


def test_a_module_that_is_not_there_is_not_installed() -> None:
    assert extensions.is_installed("hil.core.extensions:Extensions")
    assert not extensions.is_installed("hil.core.no_such_module:Extensions")
    assert not extensions.is_installed("hil.no_such_package.module:Extensions")
