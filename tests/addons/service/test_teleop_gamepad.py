"""Teleop with a gamepad that SDL makes: held, let go and unplugged, through SDL's own path from device to layout."""

import sys
from collections.abc import Iterator

import pytest

sdl2 = pytest.importorskip("sdl2", reason="needs the extra 'teleop': pip install 'mecanum-hil[teleop]'")

from hil.addons.service.teleop.gamepad import Direction, Gamepads, Pad  # noqa: E402
from hil.core.errors import BadInputError  # noqa: E402
from hil.core.extras import install_command  # noqa: E402
from tests.support.virtual_pad import VirtualPad  # noqa: E402


@pytest.fixture
def gamepads() -> Iterator[Gamepads]:
    pads = Gamepads()
    yield pads
    pads.close()


def test_without_sdl_s_library_or_its_gamepads_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sdl2, "SDL_Init", lambda _: -1)
    monkeypatch.setattr(sdl2, "SDL_GetError", lambda: b"no driver")
    with pytest.raises(BadInputError, match="gamepads cannot be read: no driver"):
        Gamepads()
    monkeypatch.setattr("hil.addons.service.teleop.gamepad.need", lambda *_: None)  # the package is there
    monkeypatch.setitem(sys.modules, "sdl2", None)
    with pytest.raises(BadInputError) as refused:
        Gamepads()
    assert str(refused.value).startswith("a gamepad needs SDL, whose library is not found (import of sdl2 halted")
    assert str(refused.value).endswith(f"); run: {install_command('teleop')}")


def test_a_gamepad_is_found_read_and_lost(gamepads: Gamepads) -> None:
    assert gamepads.poll() is None
    assert gamepads.name is None
    virtual = VirtualPad()
    assert gamepads.poll() == Pad(dead_man=False, estop=False, sticks=Direction(0.0, 0.0, 0.0))
    assert gamepads.name == "Virtual Controller"
    virtual.push(sdl2.SDL_CONTROLLER_AXIS_LEFTY, -32768)  # SDL's y points down
    virtual.push(sdl2.SDL_CONTROLLER_AXIS_LEFTX, 32767)
    virtual.push(sdl2.SDL_CONTROLLER_AXIS_RIGHTX, -16384)
    virtual.press(sdl2.SDL_CONTROLLER_BUTTON_LEFTSHOULDER)
    assert gamepads.poll() == Pad(dead_man=True, estop=False, sticks=Direction(1.0, -1.0, pytest.approx(0.5, abs=1e-4)))
    virtual.press(sdl2.SDL_CONTROLLER_BUTTON_LEFTSHOULDER, down=False)
    virtual.press(sdl2.SDL_CONTROLLER_BUTTON_B)
    state = gamepads.poll()
    assert state is not None
    assert (state.dead_man, state.estop) == (False, True)
    virtual.unplug()
    assert gamepads.poll() is None
    assert gamepads.name is None
    VirtualPad()
    assert gamepads.poll() is not None, "another one is taken"
