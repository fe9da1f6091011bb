"""The child's side of ``hil.plant.process``: pipes that an FMU's prints do not reach, and an end with the parent."""

import json
import os
import shutil
import sys
import threading
import time
from pathlib import Path
from typing import Any, NoReturn

from hil.plant import shim

_ASK_S = 1.0


class Parent:
    """The process that started this one as a ``ChildProcess``; made once, before any FMU is loaded.

    ``requests`` and ``replies`` are the descriptors of its pipes. An FMU reads nothing from stdin, and what it prints
    goes to stderr, line by line. When the parent has gone this process removes ``scratch``, the folder of its files,
    and ends, also while an FMU hangs.
    """

    def __init__(self) -> None:
        self.scratch = Path(sys.argv[1])
        self.requests, self.replies = os.dup(0), os.dup(1)
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        os.close(nothing)
        os.dup2(2, 1)
        shim.load()[1].remote_flush_lines()
        sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]  # an FMU of Python code prints there
        threading.Thread(target=self._end_with_it, args=(os.dup(2),), name="parent", daemon=True).start()
        self.say(here=True)

    def hear(self) -> dict[str, Any]:
        """Return what the parent tells next; end when there will be nothing more."""
        with open(self.requests, "rb", buffering=0, closefd=False) as lines:
            line = lines.readline()
        if not line.endswith(b"\n"):
            self.end()
        heard: dict[str, Any] = json.loads(line)
        return heard

    def say(self, **record: object) -> None:
        """Answer with a line; end when nobody hears it."""
        line = json.dumps(record).encode() + b"\n"
        try:
            while line:
                line = line[os.write(self.replies, line) :]
        except OSError:
            self.end()

    def end(self) -> NoReturn:
        """End without what the FMU registered for the end of its process, which may hang; leave no file behind."""
        shutil.rmtree(self.scratch, ignore_errors=True)
        os._exit(0)

    def _end_with_it(self, words: int) -> None:
        """End when nobody reads any more what is printed here."""
        while True:
            time.sleep(_ASK_S)
            try:
                os.write(words, b"\0")
            except OSError:
                self.end()
