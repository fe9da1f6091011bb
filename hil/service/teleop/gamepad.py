"""A gamepad, through SDL, which knows the layouts of hundreds of models. The left shoulder is the dead-man button.

SDL is the extra ``teleop``: PySDL2 with its library.
"""

import warnings
from typing import Any, NamedTuple

from hil.core.errors import BadInputError

_FULL = 32767.0


class Sticks(NamedTuple):
    """Axes of a gamepad, -1 to 1: the left stick forward and to the left, the right stick to the left."""

    forward: float
    left: float
    turn: float


class Pad(NamedTuple):
    """State of a gamepad: the left shoulder (dead-man), the east button (e-stop: B, or a circle) and the sticks."""

    dead_man: bool
    estop: bool
    sticks: Sticks


class Gamepads:
    """The first gamepad found, or another one after it was unplugged. Raises BadInputError if SDL is not installed."""

    def __init__(self) -> None:
        self._sdl = _sdl()
        self._pad: Any = None

    def close(self) -> None:
        """Release the gamepad and SDL."""
        self._sdl.SDL_Quit()

    @property
    def name(self) -> str | None:
        """The gamepad's name, or None without one."""
        if not self._pad:
            return None
        name: bytes | None = self._sdl.SDL_GameControllerName(self._pad)
        return (name or b"a gamepad").decode(errors="replace")

    def poll(self) -> Pad | None:
        """Return the state of the gamepad; None without one."""
        sdl = self._sdl
        sdl.SDL_PumpEvents()
        sdl.SDL_FlushEvents(sdl.SDL_FIRSTEVENT, sdl.SDL_LASTEVENT)
        if self._pad and not sdl.SDL_GameControllerGetAttached(self._pad):
            sdl.SDL_GameControllerClose(self._pad)
            self._pad = None
            return None
        if not self._pad:
            self._pad = self._open()
        if not self._pad:
            return None
        return Pad(
            dead_man=self._button(sdl.SDL_CONTROLLER_BUTTON_LEFTSHOULDER),
            estop=self._button(sdl.SDL_CONTROLLER_BUTTON_B),
            sticks=Sticks(
                forward=-self._axis(sdl.SDL_CONTROLLER_AXIS_LEFTY),
                left=-self._axis(sdl.SDL_CONTROLLER_AXIS_LEFTX),
                turn=-self._axis(sdl.SDL_CONTROLLER_AXIS_RIGHTX),
            ),
        )

    def _open(self) -> Any:
        sdl = self._sdl
        for index in range(sdl.SDL_NumJoysticks()):
            if sdl.SDL_IsGameController(index):
                return sdl.SDL_GameControllerOpen(index)
        return None

    def _button(self, button: int) -> bool:
        return bool(self._sdl.SDL_GameControllerGetButton(self._pad, button))

    def _axis(self, axis: int) -> float:
        steps: int = self._sdl.SDL_GameControllerGetAxis(self._pad, axis)
        return max(steps / _FULL, -1.0)


def _sdl() -> Any:
    """Return SDL, ready for gamepads only."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it warns with the name of the library that it found
            import sdl2
    except ImportError as error:
        raise BadInputError(
            f"a gamepad needs SDL, and it is not installed ({error}); pip install 'mecanum-hil[teleop]'"
        ) from error
    # Teleop handles signals itself, and has no window that could have the focus.
    sdl2.SDL_SetHint(sdl2.SDL_HINT_NO_SIGNAL_HANDLERS, b"1")
    sdl2.SDL_SetHint(sdl2.SDL_HINT_JOYSTICK_ALLOW_BACKGROUND_EVENTS, b"1")
    if sdl2.SDL_Init(sdl2.SDL_INIT_GAMECONTROLLER) != 0:
        raise BadInputError(f"gamepads cannot be read: {sdl2.SDL_GetError().decode(errors='replace')}")
    return sdl2
