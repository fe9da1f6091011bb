"""The plant FMU in its own process, with the same plant port: a crash or hang affects only that process."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

from hil.core.clock import TICK_NS
from hil.core.errors import BadInputError, DeviceError
from hil.core.scratch import scratch_folder
from hil.core.subprocesses import DEFAULT_LIMIT_MB, MEMORY_IS_KNOWN
from hil.core.types import Wheels
from hil.plant import shim
from hil.plant.child_output import ChildOutput, one_line
from hil.plant.mapping import SignalMap
from hil.plant.process import THERE_S, ChildProcess, Watch
from hil.plant.start import Settable, Value

_OPENING_STEPS = 10.0  # time limits of a step that loading, initialising and resetting may take
_NO_ROWS = SignalMap()
_NO_WHY = "did not say why"  # as cosim.c writes it


class RemotePlant(shim.PlantPort):
    """An instance of an FMU behind the plant port, like ``FmuPlant``, but loaded and stepped in a child process.

    An FMU that takes longer than ``timeout_s`` for a tick counts as hung; opening and resetting may take ten times as
    long. A process that uses more memory than ``memory_limit_mb`` is ended; on a system that does not report the
    memory of a process, the first line of ``output`` says so. ``output`` has all that the FMU prints and logs. When the
    child ends, the exchange fails, and ``message`` says why. The child never outlives this process.

    Raises BadInputError as ``FmuPlant`` does, and DeviceError when the FMU fails, crashes or hangs while it is opened.
    """

    _functions = "remote"
    output: ChildOutput

    def __init__(
        self,
        fmu: Path,
        start: Mapping[str, Value],
        mapping: SignalMap = _NO_ROWS,
        *,
        timeout_s: float = 2.0,
        memory_limit_mb: float = DEFAULT_LIMIT_MB,
    ) -> None:
        self._fmu, self._timeout_s, self._memory_limit_mb = fmu, timeout_s, memory_limit_mb
        self._config = {"fmu": str(fmu.absolute()), "start": dict(start), "mapping": asdict(mapping)}
        self._ffi, self._lib = shim.load()
        self._context = self._ffi.new("remote_plant *")
        self._read_truth(self._ffi.addressof(self._context.newest, "time_ns"))
        self._wiring: tuple[Sequence[int], Sequence[int]] = ((0, 1, 2, 3), (1, 1, 1, 1))
        self._closed = False
        self.output = ChildOutput()
        if not MEMORY_IS_KNOWN:
            text = f"nothing yet; its limit of {memory_limit_mb:g} MB is not watched on this system\n"
            self.output.feed(text.encode())
        self._open()

    def _open(self) -> None:
        self._text = ""
        with contextlib.ExitStack() as resources:
            scratch = resources.enter_context(
                scratch_folder("plant")
            )  # of this process: a child that crashes removes none
            self.output.forget_newest()
            self._child = child = ChildProcess("hil.plant.fmu_child", scratch, output=self.output)
            resources.callback(child.close, self._timeout_s)
            self._context[0] = self._ffi.new("remote_plant *", {"pipes": child.pipes})[0]
            resources.callback(setattr, self._context, "failed", 1)
            look = partial(child.limit_memory, self._memory_limit_mb, "plant.memory_limit_mb")
            self._watch = Watch(self._pending, child.give_up, self._timeout_s, look)
            resources.callback(self._watch.stop)
            try:
                self._have_it_opened()
                self.wire(*self._wiring)
            except BaseException:
                child.kill()
                raise
            self._resources = resources.pop_all()

    def _have_it_opened(self) -> None:
        child = self._child
        with self._waiting(THERE_S):
            answer = child.receive()
        if answer is not None:
            with self._waiting(self._timeout_s * _OPENING_STEPS):
                child.send(self._config)
                answer = child.receive()
        if answer is None or "failed" in answer:
            why = self._child.ending() if answer is None else self._with_last_words(str(answer["failed"]))
            raise DeviceError(f"the plant {self._fmu.name} could not be opened: {why}")
        if "refused" in answer:
            raise BadInputError(self._with_last_words(str(answer["refused"])))
        self.lacks = frozenset(map(str, answer["lacks"]))
        self.notices = tuple(map(str, answer["notices"]))
        self.settable = {name: Settable(*row) for name, row in answer["settable"].items()}

    @property
    def pid(self) -> int:
        return self._child.pid

    @property
    def pose_address(self) -> int:
        return int(self._ffi.cast("uintptr_t", self._context.newest.pose))

    def wire(self, wheel_of_channel: Sequence[int], sign_of_channel: Sequence[int]) -> None:
        self._request(
            {"kind": self._lib.REMOTE_WIRE, "wheel_of_channel": wheel_of_channel, "sign_of_channel": sign_of_channel}
        )
        self._wiring = (tuple(wheel_of_channel), tuple(sign_of_channel))

    def step(self, torque_n_m: Wheels, ticks: int = 1) -> None:
        first = self.truth().time_ns // TICK_NS
        drive = {"enabled": 1, "torque_n_m": list(torque_n_m)}
        for tick in range(first, first + ticks):
            self._request({"kind": self._lib.REMOTE_TICK, "drive": drive | {"tick": tick}})

    def wheel_speeds(self) -> Wheels:
        return Wheels(*self._ffi.unpack(self._context.newest.wheel_speed, 4))

    @property
    def message(self) -> str:
        if not self._context.failed:
            return ""
        if not self._text:
            if self._context.foreign:
                self._child.refuse_bytes(bytes(self._ffi.buffer(self._ffi.addressof(self._context, "reply"))))
            is_ended = self._context.lost or self._context.foreign
            self._text = self._child.ending() if is_ended else self._last_reply()
        return self._text

    def reset(self) -> None:
        """As the base class does; in a new process after a failure, or if the FMU cannot be reset."""
        if self._closed:
            raise DeviceError("the plant is closed; make a new one")
        with self._waiting(self._timeout_s * _OPENING_STEPS):
            request = self._ffi.new("remote_request *", {"kind": self._lib.REMOTE_RESET})
            if self._lib.remote_ask(self._context, request) == 0:
                return
        self._resources.close()
        self._open()

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._resources.close()
            self._text = "the FMU is closed"

    def _request(self, request: Mapping[str, object]) -> None:
        if self._lib.remote_ask(self._context, self._ffi.new("remote_request *", request)) != 0:
            if not self._context.failed:
                raise BadInputError(self._words())
            raise DeviceError(f"the plant stopped at {self.truth().time_ns / 1e9:g} s: {self.message}")

    def _last_reply(self) -> str:
        """Return why the FMU failed. Waits for the end of its process, after which all its output is here."""
        self._child.wait()
        words = self._words()
        return self._with_last_words(words) if words.endswith(_NO_WHY) else words

    def _with_last_words(self, why: str) -> str:
        """Return a reason with the last line that the FMU printed, unless the reason says it already."""
        last_words = self._child.last_words()
        logged = self.output.last().partition("): ")[2]
        return why if logged and logged in why else f"{why}{last_words}"

    def _words(self) -> str:
        return one_line(self._ffi.string(self._context.reply.text).decode(errors="replace"))

    @contextlib.contextmanager
    def _waiting(self, limit_s: float) -> Iterator[None]:
        """Set another time limit for the requests in this block."""
        self._watch.limit_s = limit_s
        self._context.asked += 1
        try:
            yield
        finally:
            self._context.answered += 1
            self._watch.limit_s = self._timeout_s

    def _pending(self) -> int | None:
        asked = int(self._context.asked)
        return None if asked == self._context.answered else asked
