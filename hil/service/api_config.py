"""The configuration of the API process, its first line of input."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

HOST = "127.0.0.1"

LogStyle = Literal["text", "json"]


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of what an order may ask for. The API refuses more before the control process sees it."""

    speed_m_s: float
    """Along each axis of the robot's body."""
    yaw_rate_rad_s: float
    distance_m: float
    """From the origin of the world to a pose to go to, along each axis."""
    twist_timeout_s: float
    """How long a twist is in force; one that has waited for longer is refused."""


@dataclass(frozen=True, slots=True)
class ApiConfig:
    """The API of one service.

    Attributes:
        title: what is served, such as the scenario's name. device: its link, in words.
        limits: see there. host: address to listen on. port: 0 takes a free one.
        token_file: a user's file with the token, made if it does not exist; None for a new token at each start.
        log: format of the lines on stderr.
    """

    title: str
    device: str
    limits: Limits
    host: str = HOST
    port: int = 8770
    token_file: str | None = None
    log: LogStyle = "text"

    def to_record(self) -> dict[str, Any]:
        """Return the config as a JSON object."""
        return asdict(self)

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "ApiConfig":
        """Return the config of ``to_record``."""
        return cls(**{**record, "limits": Limits(**record["limits"])})
