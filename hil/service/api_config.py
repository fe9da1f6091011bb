"""What the API process is told when it starts, as its first line."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

HOST = "127.0.0.1"

LogStyle = Literal["text", "json"]


@dataclass(frozen=True, slots=True)
class Limits:
    """The most that an order may ask for; beyond it the API refuses before the control process sees it."""

    speed_m_s: float
    """Of the robot, along each axis of its body."""
    yaw_rate_rad_s: float
    distance_m: float
    """Of a pose to go to from the origin of the world frame, along each axis."""
    twist_timeout_s: float
    """How long a twist is in force; one that has waited for longer is not taken."""


@dataclass(frozen=True, slots=True)
class ApiConfig:
    """The API of one service.

    Attributes:
        title: what is served, such as the scenario's name. device: its link, in words.
        limits: see there. host: address to listen on; port: 0 takes a free one.
        token_file: a file of the user's with the token, made if there is none; None for one that is new at each start.
        log: how lines on stderr look.
    """

    title: str
    device: str
    limits: Limits
    host: str = HOST
    port: int = 8770
    token_file: str | None = None
    log: LogStyle = "text"

    def to_record(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return asdict(self)

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "ApiConfig":
        """Return what ``to_record`` said."""
        return cls(**{**record, "limits": Limits(**record["limits"])})
