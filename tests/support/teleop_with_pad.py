"""``hil teleop --gamepad`` with a gamepad of SDL's own, which follows the lines of a FIFO."""

import sys
import threading
from pathlib import Path

import sdl2

from hil.cli.main import main
from tests.support.virtual_pad import VirtualPad


def handle(fifo: Path) -> None:
    with fifo.open() as lines:
        assert next(lines) == "plug\n"
        pad = VirtualPad()
        does = {
            "press": lambda: pad.press(sdl2.SDL_CONTROLLER_BUTTON_LEFTSHOULDER),
            "let_go": lambda: pad.press(sdl2.SDL_CONTROLLER_BUTTON_LEFTSHOULDER, down=False),
            "forward": lambda: pad.push(sdl2.SDL_CONTROLLER_AXIS_LEFTY, -32768),
            "unplug": pad.unplug,
        }
        for line in lines:
            does[line.strip()]()


if __name__ == "__main__":
    threading.Thread(target=handle, args=(Path(sys.argv[1]),), daemon=True).start()
    sys.argv[1:] = ["teleop", "--gamepad"]
    main()
