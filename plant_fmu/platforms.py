"""The platforms of the FMU's binaries, and where an archive of each FMI version holds them.

FMI 3.0 section 2.5.1.4 names a platform by architecture and system: ``x86_64-linux``. In FMI 2.0 (2.0.4 section 2.3)
the names ``linux64``, ``win64`` and ``darwin64`` stand for x86-64, and every other platform has its FMI 3.0 name. Some
importers are older than that rule: FMPy 0.3 and FMI Library (in PyFMI and libcosim) use only the word size, and look
into ``linux64`` on ARM too.
"""

import platform
import struct
import sys
from collections.abc import Mapping

# Platforms with binaries in a release, and zig's names for them. The C libraries are old, so that the binaries run on
# any system of the last ten years: glibc 2.17, macOS 11, and on Windows the C runtime of Windows 10.
ZIG_TARGETS = {
    "x86_64-linux": "x86_64-linux-gnu.2.17",
    "aarch64-linux": "aarch64-linux-gnu.2.17",
    "x86_64-windows": "x86_64-windows-gnu",
    "x86_64-darwin": "x86_64-macos.11.0",
    "aarch64-darwin": "aarch64-macos.11.0",
}
_FMI_2_NAMES = {
    "x86_64-linux": "linux64",
    "x86_64-windows": "win64",
    "x86_64-darwin": "darwin64",
    "x86-linux": "linux32",
    "x86-windows": "win32",
}
_FAT_MAGIC = 0xCAFEBABE
_FAT_ALIGNMENT = 14  # a power of two: Apple's processors have pages of 16 KiB


def this_platform() -> str:
    """Return the platform tuple of the running Python: ``x86_64-linux``."""
    machine = platform.machine().lower()
    wide = sys.maxsize > 2**32
    if machine in {"amd64", "x86_64", "i386", "i586", "i686", "x86"}:
        machine = "x86_64" if wide else "x86"
    elif machine in {"arm64", "aarch64"}:
        machine = "aarch64" if wide else "aarch32"
    system = {"win32": "windows", "darwin": "darwin"}.get(sys.platform, "linux")
    return f"{machine}-{system}"


def suffix(name: str) -> str:
    """Return the suffix of a shared library on a platform, given as a tuple."""
    return {"windows": ".dll", "darwin": ".dylib"}.get(name.split("-")[1], ".so")


def members(fmi: int, model_identifier: str, libraries: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return the members of an archive under ``binaries/``, for libraries by platform tuple.

    FMI 3.0 has a folder per tuple. FMI 2.0 has the standard's names, and two additions for importers that use only the
    word size. ``darwin64`` is a universal binary. If a system has no x86-64 library, its old name holds the existing
    library, so that an FMU built on an ARM machine for itself loads there.
    """
    made: dict[str, bytes] = {}
    if fmi == 2:
        processors = [libraries[name] for name in ("x86_64-darwin", "aarch64-darwin") if name in libraries]
        if len(processors) == 2:
            libraries = {**libraries, "x86_64-darwin": universal(processors)}
    for name, library in libraries.items():
        folder = _FMI_2_NAMES.get(name, name) if fmi == 2 else name
        made[f"binaries/{folder}/{model_identifier}{suffix(name)}"] = library
    if fmi == 2:
        for name, library in libraries.items():
            made.setdefault(f"binaries/{word_size_name(name)}/{model_identifier}{suffix(name)}", library)
    return made


def universal(libraries: list[bytes]) -> bytes:
    """Return one Mach-O file for several processors: Apple's fat header, then each library on pages of its own."""
    made = bytearray(struct.pack(">II", _FAT_MAGIC, len(libraries)).ljust(8 + 20 * len(libraries), b"\0"))
    for place, library in enumerate(libraries):
        made += bytes(-len(made) % (1 << _FAT_ALIGNMENT))
        processor, subtype = struct.unpack_from("<II", library, 4)
        entry = (processor, subtype, len(made), len(library), _FAT_ALIGNMENT)
        struct.pack_into(">IIIII", made, 8 + 20 * place, *entry)
        made += library
    return bytes(made)


def word_size_name(name: str) -> str:
    """Return the name of a platform tuple for FMI 2.0 importers that use only the word size: ``linux64``."""
    machine, system = name.split("-")
    return f"{'win' if system == 'windows' else system}{64 if '64' in machine else 32}"
