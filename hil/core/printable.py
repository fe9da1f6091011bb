"""Text from elsewhere (a device, a recording, a law, a file's name) made harmless where it leaves this program.

A terminal obeys control characters: it moves its cursor, changes its title, or types a text. All output passes
``printable``: the streams of a command, the log of a service, pages, and the texts of a viewer.
A shell obeys more characters: ``command`` makes each command line that a user is to type.
"""

import re
import shlex
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path, PurePath
from typing import TextIO

# Control characters but tab and line feed; marks that turn the direction of text (all that Unicode has, Bidi_Control)
# or end a line; halves of a character.
_HARMFUL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def printable(text: str) -> str:
    r"""Return a text with an escape in the place of each character that a terminal would obey; its lines stay.

    >>> printable("red: \x1b[31m\n")
    'red: \\x1b[31m\n'
    """
    return _HARMFUL.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


_PLAIN_ON_WINDOWS = re.compile(r"[\w\-+./\\:=@~]+")


def command(*words: str | PurePath) -> str:
    """Return a command line with its arguments quoted for a shell: sh and similar, on Windows cmd and PowerShell.

    A path that begins with a hyphen is written so that no program takes it for an option.

    >>> command("hil", "view", PurePath("my runs/first circle.rrd"))
    "hil view 'my runs/first circle.rrd'"
    """
    texts = [f"./{word}" if isinstance(word, PurePath) and str(word).startswith("-") else str(word) for word in words]
    if sys.platform != "win32":
        return shlex.join(texts)
    quoted = ((text, subprocess.list2cmdline([text])) for text in texts)
    # list2cmdline quotes for the program that reads the line; the shell before it has characters of its own.
    return " ".join(word if word != text or _PLAIN_ON_WINDOWS.fullmatch(text) else f'"{text}"' for text, word in quoted)


def seen_from_here(path: Path) -> Path:
    """Return a path relative to the current folder, if it is below that."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


class PrintableStream:
    """A text stream that writes ``printable`` text to ``raw``. A carriage return that is written alone is ours."""

    def __init__(self, raw: TextIO) -> None:
        self.raw = raw

    def write(self, text: str) -> int:
        """Write a text and return the number of characters that were written."""
        return self.raw.write(text if text == "\r" else printable(text))

    def writelines(self, lines: Iterable[str]) -> None:
        """Write texts one after another."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> object:
        return getattr(self.raw, name)


def raw_stream(stream: TextIO) -> TextIO:
    """Return the stream below a ``PrintableStream``, or the stream itself."""
    return stream.raw if isinstance(stream, PrintableStream) else stream
