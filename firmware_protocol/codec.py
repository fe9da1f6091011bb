"""Messages to frames and back: the typed side of the wire, the same for serial and CAN.

The messages are the classes of ``firmware_protocol.generated.messages``, in the units of wheel.dbc.
"""

from typing import Literal

from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import LENGTHS, MESSAGES, NAMES
from firmware_protocol.message import Message

__all__ = ["LENGTHS", "MESSAGES", "NAMES", "Message", "Refusal", "decode", "encode", "refusal"]

Refusal = Literal["unknown_id", "length", "range"]
"""Why a frame is not a message."""


def encode(message: Message) -> Frame:
    """Return the frame of a message.

    Raises ValueError naming message, field, value and range when a value cannot be sent.
    """
    return Frame(message.ID, message.encode())


def decode(frame: Frame) -> Message | None:
    """Return the message of a frame, or None if it is not a message; ``refusal`` then returns why. Never raises."""
    number, payload = frame
    kind = MESSAGES.get(number)
    return None if kind is None else kind.decode(payload)


def refusal(frame: Frame) -> Refusal:
    """Return why ``decode`` returned None for this frame; only the counters need it."""
    length = LENGTHS.get(frame.id)
    if length is None:
        return "unknown_id"
    return "length" if len(frame.payload) != length else "range"
