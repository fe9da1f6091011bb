"""An FMU in a process of its own: the child of ``hil.plant.remote``.

``python -m hil.plant.serve`` says on stdout when it is there, takes one line of JSON that names the FMU, answers with
one line whether it is open, and then answers the requests of ``remote.h`` until its stdin ends.
"""

import json
import os
import shutil
import tempfile
import threading
import time
from pathlib import Path
from typing import Any, NoReturn

from hil.errors import BadInputError, HilError
from hil.plant import shim
from hil.plant.fmu import FmuPlant
from hil.plant.mapping import Row, SignalMap
from hil.plant.process import handle

_ASK_S = 1.0


def main() -> None:
    """Serve one FMU."""
    ffi, lib = shim.load()
    requests, replies = _take_pipes()
    lib.remote_flush_lines()
    threading.Thread(target=_end_with_parent, args=(os.dup(2),), name="parent", daemon=True).start()
    _say(replies, {"here": True})
    with open(requests, "rb", buffering=0, closefd=False) as lines:
        line = lines.readline()
    if not line:
        _end()
    config = json.loads(line)
    tempfile.tempdir = config["scratch"]
    rows = {signal: Row(*row) for signal, row in config["rows"].items()}
    mapping = SignalMap(rows, config["counts_per_revolution"], config["torque_constant_n_m_a"])
    try:
        plant = FmuPlant(Path(config["fmu"]), config["start"], config["step_ns"], mapping)
    except HilError as error:
        _say(replies, {"refused" if isinstance(error, BadInputError) else "failed": str(error)})
        _end()
    _say(replies, {"open": True, "lacks": sorted(plant.lacks)})
    pipes = ffi.new("remote_pipes *", {"read_end": handle(requests), "write_end": handle(replies)})
    request, reply = ffi.new("remote_request *"), ffi.new("remote_reply *")
    exchange = ffi.cast("wheel_plant_exchange", plant.exchange_address)
    context = ffi.cast("void *", plant.context_address)
    while lib.remote_next(pipes, request) == 0:
        reply.status, message = _prepare(plant, request, lib)
        if reply.status == lib.REMOTE_DONE:
            drive = ffi.addressof(request, "drive") if request.kind == lib.REMOTE_TICK else ffi.NULL
            if exchange(context, drive, ffi.addressof(reply, "sense")) != 0:
                reply.status, message = lib.REMOTE_FAILED, plant.message
        if message:
            reply.text = message.encode()[: ffi.sizeof(reply.text) - 1]
        reply.time_ns, reply.pose, reply.twist = plant.truth()
        reply.wheel_speed = plant.wheel_speeds()
        if lib.remote_answer(pipes, reply) != 0:
            break
    plant.close()
    _end()


def _prepare(plant: FmuPlant, request: Any, lib: Any) -> tuple[int, str]:
    """Do what comes before the exchange; return the status, and why it is not REMOTE_DONE."""
    try:
        if request.kind == lib.REMOTE_WIRE:
            plant.wire(list(request.wheel_of_channel), list(request.sign_of_channel))
        elif request.kind == lib.REMOTE_RESET:
            plant.reset()
    except BadInputError as error:
        return lib.REMOTE_REFUSED, str(error)
    except HilError as error:
        return lib.REMOTE_FAILED, str(error)
    return lib.REMOTE_DONE, ""


def _take_pipes() -> tuple[int, int]:
    """Return where requests come from and replies go; what an FMU prints goes to stderr, and it can read nothing."""
    requests, replies = os.dup(0), os.dup(1)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    return requests, replies


def _say(replies: int, record: dict[str, object]) -> None:
    line = json.dumps(record).encode() + b"\n"
    while line:
        line = line[os.write(replies, line) :]


def _end_with_parent(words: int) -> None:
    """End when the parent has, also while the FMU hangs: nobody reads any more what we print."""
    while True:
        time.sleep(_ASK_S)
        try:
            os.write(words, b"\0")
        except OSError:
            _end()


def _end() -> NoReturn:
    """End without what the FMU registered for the end of its process, which may hang; leave no file behind."""
    if tempfile.tempdir is not None:
        shutil.rmtree(tempfile.tempdir, ignore_errors=True)
    os._exit(0)


if __name__ == "__main__":
    main()
