"""Finds services on this machine: each has a record and a token in its user's state folder."""

import dataclasses

from hil.core.errors import BadInputError
from hil.core.process_lock import LockHeldError, ProcessLock, held
from hil.core.tokens import state_folder


@dataclasses.dataclass(frozen=True, slots=True)
class Service:
    """A running service: its URL, its control process, what it drives, the file with its token.

    ``estop_url`` is that of its port for emergency stops.
    """

    url: str
    pid: int
    title: str
    device: str
    token_file: str
    estop_url: str = ""

    @property
    def port(self) -> int:
        """Port of its API."""
        return int(self.url.rpartition(":")[2])


def announce(service: Service) -> ProcessLock:
    """Announce a service until the claim is released or this process ends. Raises BadInputError."""
    try:
        return ProcessLock(state_folder("services"), str(service.port), dataclasses.asdict(service))
    except LockHeldError as error:
        raise BadInputError(
            f"port {service.port}: process {error.holder.get('pid', '?')} serves there; choose another port"
        ) from None


def running() -> list[Service]:
    """Return this user's running services, sorted by port."""
    return sorted((Service(**record) for record in held(state_folder("services"))), key=lambda service: service.port)
