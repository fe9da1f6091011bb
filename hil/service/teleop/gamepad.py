"""A gamepad, through SDL, which knows the layouts of hundreds: the left shoulder must be held.

SDL is the extra ``teleop``: PySDL2 with its library.
"""

import warnings
from typing import Any, NamedTuple

from hil.core.errors import BadInputError
from hil.service.teleop.mapping import Sticks

_FULL = 32767.0


class Pad(NamedTuple):
    """How a gamepad is held: the left shoulder (dead-man), the east button (e-stop: B, or a circle) and the sticks."""

    dead_man: bool
    estop: bool
    sticks: Sticks


class Gamepads:
    """The first gamepad that is there; another when that has gone. Raises BadInputError where SDL is not installed."""

    def __init__(self) -> None:
        self._sdl = _sdl()
        self._pad: Any = None

    def close(self) -> None:
        """Let go of it."""
        self._sdl.SDL_Quit()

    @property
    def name(self) -> str | None:
        """The gamepad's own name, None while there is none."""
        if not self._pad:
            return None
        name: bytes | None = self._sdl.SDL_GameControllerName(self._pad)
        return (name or b"a gamepad").decode(errors="replace")

    def poll(self) -> Pad | None:
        """Return how it is held now; None when it has gone, or none has come."""
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
            warnings.simplefilter("ignore")  # it says which library it has found
            import sdl2
    except ImportError as error:
        raise BadInputError(
            f"a gamepad needs SDL, and it is not there ({error}); pip install 'mecanum-hil[teleop]'"
        ) from error
    # Signals are ours, and there is no window that could have the focus.
    sdl2.SDL_SetHint(sdl2.SDL_HINT_NO_SIGNAL_HANDLERS, b"1")
    sdl2.SDL_SetHint(sdl2.SDL_HINT_JOYSTICK_ALLOW_BACKGROUND_EVENTS, b"1")
    if sdl2.SDL_Init(sdl2.SDL_INIT_GAMECONTROLLER) != 0:
        raise BadInputError(f"gamepads cannot be read: {sdl2.SDL_GetError().decode(errors='replace')}")
    return sdl2
