"""The host's half of the protocol as tests use it: frames in one by one, feedback out."""

import hashlib
import tracemalloc
from collections.abc import Callable, Iterable

from firmware_protocol import codec
from firmware_protocol.client import Client
from firmware_protocol.codec import Message
from firmware_protocol.framing import Frame, pack
from firmware_protocol.generated import messages as m
from hil.core.types import Wheels
from hil.robot.snapshot import Feedback


def new_client(mode: m.Mode = m.Mode.SPEED, nonce: int = 1) -> Client:
    """Return a client of a robot whose parameter hash ends with 0x5A."""
    return Client(mode, 0x5A, nonce, Feedback, Wheels)


def feedback(client: Client) -> Feedback | None:
    """Return the newest snapshot, None before the first."""
    view = client.view
    if not view.has_feedback:
        return None
    fl, fr, rr, rl = view.encoder_count
    x, y, z = view.acceleration_m_s2
    return Feedback(
        view.robot_time_us * 1000,
        m.State(view.state),
        view.command_sequence,
        view.command_age_ms,
        (fl, fr, rr, rl),
        Wheels(*view.speed_rad_s),
        Wheels(*view.current_a),
        (x, y, z),
        view.yaw_rate_rad_s,
    )


def take(client: Client, frames: Iterable[Frame], now_ns: int = 0) -> list[int]:
    """Have the client take frames that arrive together; return the ids of the messages behind which it stopped."""
    packed, at, ids = pack(frames), 0, []
    while at < len(packed):
        before, at = at, client.take(packed, at, now_ns)
        if client.view.message_id:
            begin = client.view.message_at
            assert (packed[begin] | packed[begin + 1] << 8, begin + 3 + packed[begin + 2]) == (
                client.view.message_id,
                at,
            )
            ids.append(client.view.message_id)
        if client.view.log_is_due:
            client.hash_log()
        assert at > before
    return ids


def feed(client: Client, messages: Iterable[Message]) -> list[Feedback]:
    """Return every snapshot that the messages complete."""
    found = []
    for message in messages:
        before = client.view.snapshots
        take(client, [codec.encode(message)])
        if client.view.snapshots != before:
            assert client.view.snapshots == before + 1
            newest = feedback(client)
            assert newest is not None
            found.append(newest)
    return found


def sent(client: Client) -> list[Message]:
    """Return the messages that wait to be sent, as if they were sent."""
    messages = [codec.decode(frame) for frame in client.out()]
    client.sent()
    assert None not in messages
    return [message for message in messages if message is not None]


def digest(to_robot: Iterable[Message], to_host: Iterable[Message]) -> str:
    """Return what ``Client.hexdigest`` is when these messages were sent and received."""
    each = [hashlib.sha256(pack(map(codec.encode, way))).digest() for way in (to_robot, to_host)]
    return hashlib.sha256(b"".join(each)).hexdigest()


def kept_bytes(call: Callable[[], object]) -> int:
    """Return how much memory a thousand calls leave behind, without what other threads take meanwhile."""
    tracemalloc.start(10)
    try:
        for _ in range(1000):
            call()
        snapshot = tracemalloc.take_snapshot()
    finally:
        tracemalloc.stop()
    ours = tracemalloc.Filter(True, __file__, all_frames=True)
    return sum(trace.size for trace in snapshot.filter_traces([ours]).traces)
