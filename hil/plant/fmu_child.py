"""An FMU in a process of its own: the child of ``hil.plant.remote``.

``python -m hil.plant.fmu_child SCRATCH`` writes a line of JSON to stdout when it has started. It reads one line that
names the FMU, and answers with one line whether it is open. Then it answers the requests of ``remote.h`` until its
stdin ends. All its files are in the folder SCRATCH, which it removes.
"""

import tempfile
from pathlib import Path
from typing import Any

from hil.core.errors import BadInputError, HilError
from hil.plant import shim
from hil.plant.fmu import FmuPlant
from hil.plant.mapping import Row, SignalMap
from hil.plant.process import Parent, pipes


def main() -> None:
    """Serve one FMU."""
    ffi, lib = shim.load()
    parent = Parent()
    config = parent.receive()
    tempfile.tempdir = str(parent.scratch)
    rows = {signal: Row(*row) for signal, row in config["mapping"].pop("rows").items()}
    mapping = SignalMap(rows, **config["mapping"])
    try:
        plant = FmuPlant(Path(config["fmu"]), config["start"], mapping, prints_log=True)
    except HilError as error:
        parent.send(**{"refused" if isinstance(error, BadInputError) else "failed": str(error)})
        parent.end()
    parent.send(open=True, lacks=sorted(plant.lacks), settable=plant.settable, notices=plant.notices)
    to_parent = ffi.new("remote_pipes *", pipes(parent.requests, parent.replies))
    request, reply = ffi.new("remote_request *"), ffi.new("remote_reply *")
    exchange = ffi.cast("wheel_plant_exchange", plant.exchange_address)
    context = ffi.cast("void *", plant.context_address)
    while lib.remote_next(to_parent, request) == 0:
        reply.status, message = _prepare(plant, request, lib)
        if reply.status == lib.REMOTE_DONE:
            drive = ffi.addressof(request, "drive") if request.kind == lib.REMOTE_TICK else ffi.NULL
            if exchange(context, drive, ffi.addressof(reply, "sense")) != 0:
                reply.status, message = lib.REMOTE_FAILED, plant.message
        if message:
            reply.text = message.encode()[: ffi.sizeof(reply.text) - 1]
        reply.time_ns, reply.pose, reply.twist = plant.truth()
        reply.wheel_speed = plant.wheel_speeds()
        if lib.remote_answer(to_parent, reply) != 0 or reply.status == lib.REMOTE_FAILED:
            break  # a plant that failed is opened again, in another process
    plant.close()
    parent.end()


def _prepare(plant: FmuPlant, request: Any, lib: Any) -> tuple[int, str]:
    """Do what comes before the exchange; return the status, and why it is not REMOTE_DONE."""
    try:
        if request.kind == lib.REMOTE_WIRE:
            plant.wire(list(request.wheel_of_channel), list(request.sign_of_channel))
        elif request.kind == lib.REMOTE_RESET:
            plant.reset()
        elif request.kind == lib.REMOTE_SET and lib.cosim_set(plant.context, request.place, request.value) != 0:
            return lib.REMOTE_FAILED, plant.message
    except BadInputError as error:
        return lib.REMOTE_REFUSED, str(error)
    except HilError as error:
        return lib.REMOTE_FAILED, str(error)
    return lib.REMOTE_DONE, ""


if __name__ == "__main__":
    main()
