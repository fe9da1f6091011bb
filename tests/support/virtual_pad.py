"""A gamepad of SDL's own layout, without hardware, in the process that reads it."""

from typing import Any

import sdl2


class VirtualPad:
    """Plugged in when it is made; SDL must be ready."""

    def __init__(self) -> None:
        self._index = sdl2.SDL_JoystickAttachVirtual(sdl2.SDL_JOYSTICK_TYPE_GAMECONTROLLER, 6, 15, 0)
        assert self._index >= 0
        self._joystick: Any = sdl2.SDL_JoystickOpen(self._index)

    def push(self, axis: int, steps: int) -> None:
        assert sdl2.SDL_JoystickSetVirtualAxis(self._joystick, axis, steps) == 0

    def press(self, button: int, *, down: bool = True) -> None:
        assert sdl2.SDL_JoystickSetVirtualButton(self._joystick, button, down) == 0

    def unplug(self) -> None:
        assert sdl2.SDL_JoystickDetachVirtual(self._index) == 0
