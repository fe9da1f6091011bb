"""Makes the ROS 2 messages and services that have no wheels, from ``interfaces/``, into the user's cache.

ROS 2's own generators write C and Python for each definition. All C of a package is compiled into its one Python
extension: with one type support, that of Fast DDS, nothing has to be found at run time. That takes half a minute of a
processor, once for a version of definitions and generators. A sourced ROS installation has the packages, and is used.
"""

import functools
import io
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Sequence
from contextlib import redirect_stdout
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

from hil.core.errors import BadInputError

PACKAGES = {
    "tf2_msgs": ("builtin_interfaces", "std_msgs", "geometry_msgs"),
    "simulation_interfaces": ("builtin_interfaces", "service_msgs", "std_msgs", "geometry_msgs"),
}
"""The packages that are made, with those whose types they use."""

_DEFINITIONS = Path(__file__).parent / "interfaces"
_FAST_DDS = "rosidl_typesupport_fastrtps_c"
_LIBRARIES = ("rosidl_generator_c", _FAST_DDS, "rosidl_typesupport_c", "rosidl_generator_py")  # of a package's types
_RUNTIME = ("rosidl_runtime_c", "rosidl_typesupport_c", _FAST_DDS, "rosidl_typesupport_fastrtps_cpp")
_FURTHER = ("fastcdr", "rcutils", "rmw")
_MADE_AS = "1"  # changes with what this file makes of the same definitions
_LISTED = 1500  # characters of a compiler's complaint


def provide(cache: Path) -> Path:
    """Return the folder below ``cache`` with the packages, to import from; they are made if they are not there.

    Raises BadInputError when a generator or a compiler is missing, or fails.
    """
    definitions = sorted(_DEFINITIONS.glob("*/*/*.*"))
    texts = [f"{path.relative_to(_DEFINITIONS)}\n{path.read_text(encoding='utf-8')}" for path in definitions]
    ingredients = [*texts, _MADE_AS, version("ros-rosidl-generator-py"), sys.prefix, sys.version]
    folder = cache / sha256("\n".join(ingredients).encode()).hexdigest()[:16]
    if not folder.exists():
        cache.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=cache) as work:
            command = [sys.executable, "-P", "-m", "hil.service.ros2.generate", work]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                raise BadInputError(
                    f"ROS 2's messages of {' and '.join(PACKAGES)} could not be made: {done.stderr[-_LISTED:].strip()}"
                )
            _put_into_place(Path(work), folder)
    return folder


def _put_into_place(made: Path, folder: Path) -> None:
    try:
        made.rename(folder)
    except OSError:  # another process was faster, and made the same
        if not folder.exists():
            raise
    else:
        made.mkdir()  # for the end of the temporary folder


def main() -> int:
    """Make all packages in the folder that is named on the command line."""
    compilers = [shutil.which(os.environ.get(name, usual)) for name, usual in (("CC", "cc"), ("CXX", "c++"))]
    if None in compilers:
        print("a compiler of C or C++ is missing; on Debian: apt install g++", file=sys.stderr)
        return BadInputError.exit_code
    from rosidl_parser import parser

    # Each generator would parse each definition anew, which takes the longest.
    parsed: dict[Path, Any] = {}
    parse = parser.parse_idl_file

    @functools.wraps(parse)
    def parse_once(locator: Any, *arguments: Any) -> Any:
        path = locator.get_absolute_path()
        if path not in parsed:
            parsed[path] = parse(locator, *arguments)
        return parsed[path]

    parser.parse_idl_file = parse_once
    folder = Path(sys.argv[1]).resolve()
    with redirect_stdout(io.StringIO()):
        for package, used in PACKAGES.items():
            c = _generate(package, used, folder / package)
            try:
                _compile(package, used, folder / package, c)
            except subprocess.CalledProcessError:  # the compiler has said why
                return BadInputError.exit_code
            shutil.rmtree(c)
    return 0


def _generate(package: str, used: Sequence[str], folder: Path) -> Path:
    """Write the Python of a package into its folder, and return the folder with its C."""
    from rosidl_adapter import convert_to_idl
    from rosidl_generator_c import generate_c
    from rosidl_generator_py.generate_py_impl import generate_py
    from rosidl_generator_type_description import generate_type_hash
    from rosidl_typesupport_c import generate_c as generate_typesupport_c
    from rosidl_typesupport_fastrtps_c import generate_typesupport_fastrtps_c

    share, work, definitions = Path(sys.prefix) / "share", folder / "c", _DEFINITIONS / package
    names = sorted(path.relative_to(definitions) for path in definitions.glob("*/*.*"))
    for name in names:
        convert_to_idl(definitions, package, name, work / "idl")
    idl = [name.with_suffix(".idl").as_posix() for name in names]

    def arguments(generator: str, into: Path, **further: Any) -> str:
        file = work / f"{generator}.json"
        values = {
            "package_name": package,
            "output_dir": str(into),
            "template_dir": str(share / generator / "resource"),
            "idl_tuples": [f"{work / 'idl'}:{name}" for name in idl],
            "ros_interface_dependencies": [],
            "target_dependencies": [],
        }
        file.write_text(json.dumps(values | further), encoding="utf-8")
        return str(file)

    c, hashes = work / package, work / "hashes"
    include = [f"{name}:{share / name}" for name in used]
    generate_type_hash(arguments("rosidl_generator_type_description", hashes, include_paths=include))
    described = [f"{name}:{(hashes / name).with_suffix('.json')}" for name in idl]
    generate_c(arguments("rosidl_generator_c", c, type_description_tuples=described))
    generate_typesupport_fastrtps_c(arguments(_FAST_DDS, c))
    generate_typesupport_c(arguments("rosidl_typesupport_c", c), [_FAST_DDS])
    generate_py(arguments("rosidl_generator_py", folder), ["rosidl_typesupport_c"])
    (folder / "__init__.py").touch()
    for generator in ("rosidl_generator_c", _FAST_DDS):
        header = f"{generator}__visibility_control.h"
        text = (share / generator / "resource" / f"{header}.in").read_text(encoding="utf-8")
        text = text.replace("@PROJECT_NAME@", package).replace("@PROJECT_NAME_UPPER@", package.upper())
        (c / "msg" / header).write_text(text, encoding="utf-8")
    return work


def _compile(package: str, used: Sequence[str], folder: Path, work: Path) -> None:
    """Compile the C and C++ of a package into one extension. Raises CalledProcessError."""
    import numpy as np

    prefix = Path(sys.prefix)
    include = [work, folder.parent, sysconfig.get_path("include"), np.get_include(), prefix / "include"]
    include += [path for path in sorted((prefix / "include").iterdir()) if path.is_dir()]
    flags = [f"-I{path}" for path in include]
    objects = []
    for number, source in enumerate(sorted((*folder.rglob("*.c"), *folder.rglob("*.cpp")))):
        is_c = source.suffix == ".c"
        compiler = os.environ.get("CC", "cc") if is_c else os.environ.get("CXX", "c++")
        objects.append(work / f"{number}.o")
        standard = "-std=gnu11" if is_c else "-std=c++17"
        command = [compiler, standard, "-O1", "-w", "-fPIC", "-c", *flags, str(source), "-o", str(objects[-1])]
        subprocess.run(command, check=True)
    libraries = [f"-l{name}__{kind}" for name in used for kind in _LIBRARIES] + [
        f"-l{name}" for name in (*_RUNTIME, *_FURTHER)
    ]
    extension = folder / f"{package}_s__rosidl_typesupport_c{sysconfig.get_config_var('EXT_SUFFIX')}"
    where = [f"-L{prefix / 'lib'}", f"-Wl,-rpath,{prefix / 'lib'}"]
    linked = [str(one) for one in (extension, *objects)]
    subprocess.run([os.environ.get("CXX", "c++"), "-shared", "-o", *linked, *where, *libraries], check=True)


if __name__ == "__main__":
    sys.exit(main())
