"""Builds the firmware for the STM32F405: ELF, hex and bin, with size and worst-case stack.

``python -m firmware_protocol.arm_build`` builds every target into build/stm32f4; ``--help`` lists them. Needs
arm-none-eabi-gcc (on Debian gcc-arm-none-eabi) or the PyPI package ziglang, and no C library.
"""

import argparse
import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from firmware_protocol.arm_image import Image, read_elf, write_bin, write_hex
from firmware_protocol.arm_stack import StackUse, worst_stack
from firmware_protocol.built import HERE, BuildError

PORT = HERE / "port" / "stm32f4"
OUTPUT = Path("build") / "stm32f4"

_CORE = (*sorted((HERE / "firmware").glob("*.c")), HERE / "generated" / "wheel_messages.c")
_COMMON = (
    "startup",
    "memory",
    "uptime",
    "pins",
    "watchdog",
    "reset_cause",
    "fault",
    "supply",
    "flash_memory",
    "parameter_log",
    "robot",
    "main",
)
_HIL = ("plant_line", "plant_codec", "usart", "lockstep")
_VARIANTS = {
    "motors": ("clock_crystal", "plant_motors", "pwm", "encoders", "analog"),
    "hil": ("clock_crystal", *_HIL),
    "hil-emulated": ("clock_emulated", *_HIL),  # differs only in clock_init
}
_LINKS = {"serial": ("host_serial", "usart"), "can": ("host_can",)}


class Target(NamedTuple):
    """One firmware: its variant (how it drives its motors), its board, and its link to the host."""

    variant: str
    board: str
    link: str

    @property
    def name(self) -> str:
        """File name without its ending."""
        return "-".join(self)

    def sources(self) -> tuple[Path, ...]:
        """Return every C file of this firmware."""
        own = dict.fromkeys((*_COMMON, *_VARIANTS[self.variant], *_LINKS[self.link], f"boards/{self.board}"))
        return (*_CORE, *(PORT / f"{name}.c" for name in own))


TARGETS = (
    Target("motors", "f405_drivers", "serial"),
    Target("motors", "f405_drivers", "can"),
    Target("motors", "f405_bridges", "serial"),
    Target("motors", "f405_bridges", "can"),
    Target("hil", "hil_f405", "serial"),
    Target("hil", "hil_f405", "can"),
    Target("hil-emulated", "hil_f405", "serial"),
    Target("hil-emulated", "hil_f405", "can"),
)

_MACHINE = ("-mthumb", "-mcpu=cortex-m4", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")
_FLAGS = (
    "-std=c11",
    "-O2",
    "-g",
    "-ffreestanding",
    "-ffp-contract=off",
    "-ffunction-sections",
    "-fdata-sections",
    "-fno-common",
    "-Wall",
    "-Wextra",
    "-Wconversion",
    "-Wcast-qual",
    "-Wdouble-promotion",
    "-Werror",
)
_GCC = (
    "-nostdinc",
    "-fno-tree-loop-distribute-patterns",  # memcpy must not become a call of itself
    "-mword-relocations",  # the address of a function is one word, which arm_stack finds
)
_INCLUDE = ("-isystem", str(PORT / "include"), f"-ffile-prefix-map={HERE}=.")
_LINK = ("-nostdlib", "-Wl,--gc-sections", "-Wl,--entry=reset", f"-Wl,-T,{PORT / 'stm32f405.ld'}")
_ZIG_MACHINE = ("-target", "thumb-freestanding-eabihf", "-mcpu=cortex_m4+vfp4d16sp")
_ZIG = (
    "-fno-sanitize=all",
    "-fno-builtin",  # memcpy must not become a call of itself
    "-fno-unwind-tables",
    "-fno-asynchronous-unwind-tables",
    "-fomit-frame-pointer",
)


@dataclass(frozen=True)
class Built:
    """A built firmware: ``elf``, with ``.hex`` and ``.bin`` beside it. ``stack`` is None if zig built it."""

    target: Target
    elf: Path
    image: Image
    stack: StackUse | None


def _headers() -> list[Path]:
    return [*HERE.glob("firmware/*.h"), *HERE.glob("generated/*.h"), *PORT.rglob("*.h")]


def source_hash(target: Target) -> int:
    """Return the first 32 bits of the SHA-256 over the sources: HELLO_FIRMWARE.build."""
    digest = hashlib.sha256()
    for path in sorted({*target.sources(), *_headers(), PORT / "stm32f405.ld"}):
        digest.update(path.relative_to(HERE).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return int.from_bytes(digest.digest()[:4], "big")


def build(target: Target, output: Path = OUTPUT, objects: Path | None = None) -> Built:
    """Build one firmware into the folder ``output``, with gcc if it is installed, otherwise with zig.

    gcc's object files stay in the folder ``objects``, by default one in ``output``; one that was made of the same
    source, headers, flags and compiler is used again. Several processes may use the folder at once.

    Raises BuildError when neither is installed, or with the compiler's message when it fails.
    """
    output.mkdir(parents=True, exist_ok=True)
    elf = output / f"{target.name}.elf"
    stack = None
    if gcc := shutil.which("arm-none-eabi-gcc"):
        stack = _build_with_gcc(gcc, target, elf, output / "objects" if objects is None else objects)
    elif importlib.util.find_spec("ziglang"):
        zig = [sys.executable, "-m", "ziglang", "cc", *_ZIG_MACHINE, *_ZIG, *_FLAGS, *_INCLUDE, _build_number(target)]
        _run([*zig, *_LINK, *map(str, target.sources()), "-o", str(elf)])
    else:
        raise BuildError(
            "no C compiler for ARM is installed: install arm-none-eabi-gcc (on Debian: gcc-arm-none-eabi), or ziglang "
            "with pip"
        )
    image = read_elf(elf)
    write_hex(image, elf.with_suffix(".hex"))
    write_bin(image, elf.with_suffix(".bin"))
    return Built(target, elf, image, stack)


def _build_number(target: Target) -> str:
    return f"-DFIRMWARE_BUILD=0x{source_hash(target):08X}u"


def _build_with_gcc(gcc: str, target: Target, elf: Path, objects: Path) -> StackUse:
    compiler = [gcc, *_MACHINE, *_GCC, "-isystem", _run([gcc, "-print-file-name=include"]).strip(), *_FLAGS, *_INCLUDE]
    common = hashlib.sha256(repr((compiler, _run([gcc, "--version"]))).encode())
    for header in sorted(_headers()):
        common.update(header.read_bytes() + b"\0")

    def compiled(source: Path) -> Path:
        """Return the object file of a source; what gcc says of its stack is beside it."""
        command = [*compiler, _build_number(target)] if source.name == "robot.c" else compiler
        digest = common.copy()
        digest.update(repr((str(source), command)).encode() + source.read_bytes())
        made = objects / f"{source.stem}-{digest.hexdigest()[:16]}.o"
        if not made.exists():
            with tempfile.TemporaryDirectory(dir=objects, prefix=f".{source.stem}.") as folder:
                fresh = Path(folder) / made.name
                _run([*command, "-fstack-usage", "-c", str(source), "-o", str(fresh)])
                fresh.with_suffix(".su").replace(made.with_suffix(".su"))
                fresh.replace(made)  # last: where it is, all is
        return made

    objects.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        parts = list(pool.map(compiled, target.sources()))
    _run([gcc, *_MACHINE, *_FLAGS, *_LINK, *map(str, parts), "-o", str(elf), "-lgcc"])
    usage = "".join(part.with_suffix(".su").read_text(encoding="utf-8") for part in parts)
    objdump = str(Path(gcc).with_name(Path(gcc).name.replace("gcc", "objdump")))
    disassembly = _run([objdump, "-d", "-z", "--no-show-raw-insn", str(elf)])
    return worst_stack(disassembly, usage, read_elf(elf))


def _report(built: Built) -> str:
    image, stack = built.image, built.stack
    lines = [
        f"{built.elf} (and .hex, .bin)",
        f"  flash {image.flash} bytes (text {image.text}, data {image.data}); "
        f"RAM {image.ram} bytes (data {image.data}, bss {image.bss}, stack {image.stack})",
    ]
    if stack is None:
        lines.append("  worst-case stack not known: only arm-none-eabi-gcc tells it")
    else:
        lines.append(
            f"  worst-case stack {stack.total} bytes: {_chain(stack.main)}; interrupted in {stack.interrupt[0][0]}"
        )
        lines.append(f"  through pointers in {', '.join(stack.indirect)}: {', '.join(stack.reachable)}")
    return "\n".join(lines)


def _chain(chain: Sequence[tuple[str, int]]) -> str:
    return " > ".join(f"{name} {size}" for name, size in chain)


def _run(command: Sequence[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise BuildError(f"{' '.join(command)} failed:\n{done.stderr}")
    return done.stdout


def main(arguments: Sequence[str] | None = None) -> int:
    """Build the targets named on the command line, or all."""
    names = {target.name: target for target in TARGETS}
    parser = argparse.ArgumentParser(prog="python -m firmware_protocol.arm_build", description=__doc__)
    parser.add_argument("target", nargs="*", help=f"of {', '.join(names)}; all when none is given")
    parser.add_argument("--output", type=Path, default=OUTPUT, help="folder (default: %(default)s)")
    given = parser.parse_args(arguments)
    for name in given.target or names:
        if name not in names:
            sys.exit(f"firmware_protocol.arm_build: target {name}: expected one of {', '.join(names)}")
    for name in given.target or names:
        print(_report(build(names[name], given.output)), flush=True)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except BuildError as error:
        sys.exit(f"firmware_protocol.arm_build: {error}")
