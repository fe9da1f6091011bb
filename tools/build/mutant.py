"""Builds mutants of the firmware's library and of the plant's FMU, for ``hil verify``.

``python -m tools.build.mutant FOLDER FILE``: the file has a JSON object, the patches of each mutant by its id, each a
list of [file, before, after]. The results go to the folder, and a JSON object with the path of each, or with what the
compiler said of it (``{"ID": {"error": "..."}}``), to stdout. Sources are only read; what was built is kept. Of a
mutant only the changed file is compiled, two at once.
"""

import hashlib
import json
import sys
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import plant_fmu
from firmware_protocol.built import FIRMWARE_FLAGS, FLAGS, ROOT, SUFFIX, WHEEL_HOST, BuildError
from firmware_protocol.built import SOURCES as FIRMWARE
from hil.core.mutant import Patch
from hil.plant.built import FMUS
from plant_fmu import platforms
from plant_fmu.sources import GENERATED, SOURCES
from plant_fmu.sources import HERE as PLANT
from tools.build import pack
from tools.build.compiler import compile_object, compiler, link_shared, version

_AT_ONCE = 2


class Target(NamedTuple):
    """What can be mutated: sources, folders of headers, flags, the hash of all of it, the suffix of the result."""

    sources: tuple[Path, ...]
    include: tuple[Path, ...]
    flags: tuple[str, ...]
    digest: str | None
    suffix: str


def _quiet(flags: Sequence[str]) -> tuple[str, ...]:
    """Return the flags without warnings: a mutant may leave a function unused."""
    return (*(flag for flag in flags if not flag.startswith("-W")), "-w", "-fPIC")


FIRMWARE_TARGET = Target(FIRMWARE, (), _quiet(FIRMWARE_FLAGS), WHEEL_HOST.digest(), SUFFIX)
PLANT_TARGET = Target(SOURCES, (PLANT, GENERATED), _quiet(FLAGS), FMUS[plant_fmu.path(2)].digest(), ".fmu")


class Builder:
    """Builds mutants into a folder. Raises BuildError when the unchanged sources cannot be compiled."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._version = version(compiler())
        folder.mkdir(parents=True, exist_ok=True)

    def build(self, name: str, patches: Sequence[Patch]) -> Path:
        """Build a mutant, unless it is there, and return its path. Raises BuildError, also for a patch that fails."""
        changed = {ROOT / patch.file for patch in patches}
        targets = [target for target in (FIRMWARE_TARGET, PLANT_TARGET) if changed <= set(target.sources)]
        if not targets:
            raise BuildError(f"{sorted(map(str, changed))}: not C files of the firmware alone, or of the plant alone")
        [target] = targets
        built_from = repr((patches, target.flags, target.digest, self._version))
        out = self._folder / f"{name}-{hashlib.sha256(built_from.encode()).hexdigest()[:16]}{target.suffix}"
        if out.is_file():
            return out
        with tempfile.TemporaryDirectory(dir=self._folder, prefix=f".{name}.") as place:
            objects = [
                self._compile(target, source, [p for p in patches if ROOT / p.file == source], Path(place))
                for source in target.sources
            ]
            library = Path(place) / f"mutant{SUFFIX}"
            link_shared(objects, library)
            if target is PLANT_TARGET:
                identifier = pack.model_identifier(2)
                binaries = {platforms.this_platform(): library.read_bytes()}
                members = {**platforms.members(2, identifier, binaries), **pack.text_members(2)}
                pack.write(members, out, "a mutant of hil verify")
            else:
                library.replace(out)
        return out

    def _compile(self, target: Target, source: Path, patches: Sequence[Patch], place: Path) -> Path:
        """Return the object of a source: the one of the unchanged source is compiled once."""
        if patches:
            text = source.read_text(encoding="utf-8")
            for patch in patches:
                try:
                    text = patch.apply(text)
                except ValueError as error:
                    raise BuildError(str(error)) from error
            changed = place / source.name
            changed.write_text(text, encoding="utf-8")
            made = changed.with_suffix(".o")
            # Quoted headers are looked for beside the source first.
            compile_object(changed, made, (source.parent, *target.include), target.flags)
            return made
        key = hashlib.sha256(repr((target.digest, target.flags, self._version)).encode()).hexdigest()[:16]
        kept = self._folder / f"objects-{key}" / f"{source.stem}.o"
        if not kept.is_file():
            kept.parent.mkdir(exist_ok=True)
            made = place / kept.name
            compile_object(source, made, target.include, target.flags)
            made.replace(kept)
        return kept


def build_all(folder: Path, mutants: Mapping[str, Sequence[Patch]]) -> dict[str, dict[str, str]]:
    """Build mutants; return ``path`` or ``error`` of each by its id. Raises BuildError without a compiler."""
    builder = Builder(folder)

    def one(name: str) -> dict[str, str]:
        try:
            return {"path": str(builder.build(name, mutants[name]))}
        except (BuildError, OSError) as error:
            return {"error": str(error)}

    with ThreadPoolExecutor(_AT_ONCE) as pool:
        return dict(zip(mutants, pool.map(one, mutants), strict=True))


def main() -> None:
    """Build what the file asks for, and print what came of it."""
    if len(sys.argv) != 3:
        sys.exit("tools.build.mutant: expected a folder and a file of requests")
    requests = json.loads(Path(sys.argv[2]).read_text(encoding="utf-8"))
    mutants = {name: [Patch(*patch) for patch in patches] for name, patches in requests.items()}
    try:
        print(json.dumps(build_all(Path(sys.argv[1]), mutants)))
    except BuildError as error:
        sys.exit(f"tools.build.mutant: {error}")


if __name__ == "__main__":
    main()
