"""Worst-case stack of a firmware, from gcc's stack usage of each function and the calls in the linked code.

Frames are those of ``-fstack-usage``; calls are read from the disassembly of the linked file. A call through a pointer
may reach each function whose address occurs as a word in the code or its constants, apart from the vector table
(``-mword-relocations`` excludes any other way). Interrupts do not nest: all have the same priority.
"""

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from firmware_protocol.arm_image import Image
from firmware_protocol.built import BuildError

_FUNCTION = re.compile(r"^([0-9a-f]{8}) <(.+)>:$")
_INSTRUCTION = re.compile(r"^ *([0-9a-f]+):\t(\S+)(?:\t(.*))?$")
_TARGET = re.compile(r"\b([0-9a-f]{5,8}) <")
_CONDITION = "(?:eq|ne|cs|cc|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)?"
_BRANCH = re.compile(rf"^b{_CONDITION}(?:\.[nw])?$")
_CALL = re.compile(rf"^blx?{_CONDITION}(?:\.[nw])?$")
_POINTER = re.compile(r"^(?:bx|blx)(?:\.[nw])?$")
_USAGE = re.compile(r"^[^\t]*:(?P<name>[^:\t]+)\t(?P<bytes>\d+)\t(?P<kind>\S+)$")

_ENTRY = "reset"
_EXCEPTION_FRAME = 108
"""Bytes that the core pushes at an interrupt, with floating-point registers and alignment (ARMv7-M, B1.5.7)."""


@dataclass(frozen=True)
class StackUse:
    """The deepest use of the stack: ``main`` and ``interrupt`` are the chains of (function, bytes) that cause it.

    ``indirect`` names the functions that call through a pointer, ``reachable`` the functions those calls may reach.
    """

    main: tuple[tuple[str, int], ...]
    interrupt: tuple[tuple[str, int], ...]
    indirect: tuple[str, ...]
    reachable: tuple[str, ...]

    @property
    def total(self) -> int:
        """Bytes, with an interrupt on top of the deepest chain, and a fault's exception frame on top of that."""
        return sum(size for _, size in self.main + self.interrupt) + 2 * _EXCEPTION_FRAME


@dataclass
class _Function:
    name: str
    calls: set[int] = field(default_factory=set)
    by_pointer: bool = False


@dataclass(frozen=True)
class _Program:
    functions: Mapping[int, _Function]
    frames: Mapping[str, int]
    words: frozenset[int]

    @cached_property
    def pointed(self) -> set[int]:
        """Functions whose address, with the Thumb bit, is a word of the image."""
        return {address for address in self.functions if address | 1 in self.words}

    def frame(self, name: str) -> int:
        plain = name.split(".")[0] if name not in self.frames else name
        known = [size for key, size in self.frames.items() if key.split(".")[0] == plain]
        if not known:
            raise BuildError(f"function {name} has no stack usage: was it built without -fstack-usage?")
        return max(known)  # static functions of different files may share a name

    def deepest(self, address: int, above: tuple[int, ...] = ()) -> tuple[tuple[str, int], ...]:
        function = self.functions[address]
        if address in above:
            raise BuildError(f"function {function.name} calls itself: its stack has no bound")
        calls = function.calls | (self.pointed if function.by_pointer else set())
        chains = (self.deepest(callee, (*above, address)) for callee in calls)
        longest = max(chains, key=lambda chain: sum(size for _, size in chain), default=())
        return ((function.name, self.frame(function.name)), *longest)


def worst_stack(disassembly: str, usage: str, image: Image) -> StackUse:
    """Return the worst-case stack. ``disassembly`` is objdump's, ``usage`` the content of gcc's .su files.

    Raises BuildError when it has no bound: recursion, a frame of variable size, or a function without a known frame.
    """
    functions = _read_functions(disassembly)
    program = _Program(functions, _read_usage(usage), _read_words(image, min(functions)))
    by_name = {function.name: address for address, function in program.functions.items()}
    interrupts = [address for name, address in by_name.items() if name.endswith("_interrupt")]
    chains = [program.deepest(address) for address in interrupts]
    callers = tuple(sorted(f.name for f in program.functions.values() if f.by_pointer))
    return StackUse(
        program.deepest(by_name[_ENTRY]),
        max(chains, key=lambda chain: sum(size for _, size in chain)),
        callers,
        tuple(sorted(program.functions[address].name for address in program.pointed)) if callers else (),
    )


def _read_functions(disassembly: str) -> dict[int, _Function]:
    functions: dict[int, _Function] = {}
    current: _Function | None = None
    branches: list[tuple[_Function, int, bool]] = []
    for line in disassembly.splitlines():
        if head := _FUNCTION.match(line):
            current = functions.setdefault(int(head[1], 16), _Function(head[2]))
        elif current is not None and (instruction := _INSTRUCTION.match(line)):
            operation, operands = instruction[2], instruction[3] or ""
            is_call = _CALL.match(operation) is not None
            if (is_call or _BRANCH.match(operation)) and (target := _TARGET.search(operands)):
                branches.append((current, int(target[1], 16), is_call))
            elif _POINTER.match(operation) and operands.strip() != "lr":
                current.by_pointer = True
    for function, address, is_call in branches:
        # A branch into the middle of a function stays in it, and one to its own beginning is a loop. A branch to
        # another function's beginning is a tail call.
        if address in functions and (is_call or functions[address] is not function):
            function.calls.add(address)
    return functions


def _read_usage(usage: str) -> dict[str, int]:
    frames: dict[str, int] = {}
    for line in usage.splitlines():
        if found := _USAGE.match(line):
            if found["kind"] != "static":
                raise BuildError(f"function {found['name']} has a stack frame of changing size")
            frames[found["name"]] = max(frames.get(found["name"], 0), int(found["bytes"]))
    return frames


def _read_words(image: Image, start: int) -> frozenset[int]:
    """Return the words of the image from ``start``, the first function, on; the vector table is before it."""
    words: set[int] = set()
    for address, data in image.segments:
        own = data[max(0, start - address) :]
        words.update(word for (word,) in struct.iter_unpack("<I", own[: len(own) & ~3]))
    return frozenset(words)
