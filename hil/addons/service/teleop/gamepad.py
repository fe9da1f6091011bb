"""A gamepad, through SDL, which knows the layouts of hundreds of models. The left shoulder is the dead-man button.

SDL is the extra ``teleop``: PySDL2 with its library.
"""

import warnings
from typing import Any, NamedTuple

from hil.core.errors import BadInputError
from hil.core.extras import install_command, need

_FULL = 32767.0


class Direction(NamedTuple):
    """Shares from -1 to 1 of the full speeds, or of a stick's travel: forward, to the left, and turning to the left."""

    forward: float
    left: float
    turn: float


class Pad(NamedTuple):
    """State of a gamepad: the left shoulder (dead-man), the east button (e-stop: B, or a circle) and the sticks.

    The left stick gives ``forward`` and ``left`` of ``sticks``, the right one ``turn``.
    """

    dead_man: bool
    estop: bool
    sticks: Direction


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
            found = next(filter(sdl.SDL_IsGameController, range(sdl.SDL_NumJoysticks())), None)
            if found is None:
                return None
            self._pad = sdl.SDL_GameControllerOpen(found)
        if not self._pad:
            return None
        dead_man, estop = (
            bool(sdl.SDL_GameControllerGetButton(self._pad, button))
            for button in (sdl.SDL_CONTROLLER_BUTTON_LEFTSHOULDER, sdl.SDL_CONTROLLER_BUTTON_B)
        )
        axes = (sdl.SDL_CONTROLLER_AXIS_LEFTY, sdl.SDL_CONTROLLER_AXIS_LEFTX, sdl.SDL_CONTROLLER_AXIS_RIGHTX)
        # SDL's axes point down and to the right.
        sticks = (-max(sdl.SDL_GameControllerGetAxis(self._pad, axis) / _FULL, -1.0) for axis in axes)
        return Pad(dead_man, estop, Direction(*sticks))


def _sdl() -> Any:
    """Return SDL, ready for gamepads only."""
    need("teleop", "a gamepad")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it warns with the name of the library that it found
            import sdl2
    except ImportError as error:
        raise BadInputError(
            f"a gamepad needs SDL, whose library is not found ({error}); run: {install_command('teleop')}"
        ) from error
    # Teleop handles signals itself, and has no window that could have the focus.
    sdl2.SDL_SetHint(sdl2.SDL_HINT_NO_SIGNAL_HANDLERS, b"1")
    sdl2.SDL_SetHint(sdl2.SDL_HINT_JOYSTICK_ALLOW_BACKGROUND_EVENTS, b"1")
    if sdl2.SDL_Init(sdl2.SDL_INIT_GAMECONTROLLER) != 0:
        raise BadInputError(f"gamepads cannot be read: {sdl2.SDL_GetError().decode(errors='replace')}")
    return sdl2
