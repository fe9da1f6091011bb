"""A ROS 2 node of its own that a test speaks to by lines of JSON: it publishes, listens and calls services.

{"listen": "/odom", "type": "nav_msgs/msg/Odometry"}              remembers the newest message
{"newest": "/odom"}                                              -> {"message": {...} or null, "count": 7}
{"publish": "/cmd_vel", "type": "...", "values": {...}, "rate_hz": 20}     until the next one on this topic; 0 ends
{"once": "/path", "type": "...", "values": {...}}                 when somebody listens
{"call": "/mecanum_hil/arm", "type": "...", "values": {...}}      -> {"answer": {...}}
"""

import json
import select
import sys
import time
from importlib import import_module
from typing import Any

import rclpy
from rclpy.qos import qos_profile_sensor_data

_LIMIT_S = 60.0


class Peer:
    """The node, and its received messages."""

    def __init__(self) -> None:
        rclpy.init()
        self.node = rclpy.create_node("peer")
        self.newest: dict[str, Any] = {}
        self.counts: dict[str, int] = {}
        self.publishers: dict[str, Any] = {}
        self.timers: dict[str, Any] = {}
        self.clients: dict[str, Any] = {}

    def handle(self, asked: dict[str, Any]) -> dict[str, Any]:
        """Do what a line asks for, and return its answer."""
        word = next(iter(asked))
        return getattr(self, f"_{word}")(asked[word], asked)

    def _listen(self, topic: str, asked: dict[str, Any]) -> dict[str, Any]:
        def hear(message: Any) -> None:
            self.newest[topic] = message
            self.counts[topic] = self.counts.get(topic, 0) + 1

        self.node.create_subscription(_type(asked["type"]), topic, hear, qos_profile_sensor_data)
        return {}

    def _newest(self, topic: str, _: dict[str, Any]) -> dict[str, Any]:
        message = self.newest.get(topic)
        return {"message": message and _values(message), "count": self.counts.get(topic, 0)}

    def _publish(self, topic: str, asked: dict[str, Any]) -> dict[str, Any]:
        if (timer := self.timers.pop(topic, None)) is not None:
            self.node.destroy_timer(timer)
        if asked["rate_hz"]:
            message, publisher = _message(_type(asked["type"]), asked["values"]), self._publisher(topic, asked)
            self.timers[topic] = self.node.create_timer(1.0 / asked["rate_hz"], lambda: publisher.publish(message))
        return {}

    def _once(self, topic: str, asked: dict[str, Any]) -> dict[str, Any]:
        publisher = self._publisher(topic, asked)
        self._spin_until(lambda: publisher.get_subscription_count() > 0)
        publisher.publish(_message(_type(asked["type"]), asked["values"]))
        return {}

    def _publisher(self, topic: str, asked: dict[str, Any]) -> Any:
        if topic not in self.publishers:
            self.publishers[topic] = self.node.create_publisher(_type(asked["type"]), topic, 1)
        return self.publishers[topic]

    def _call(self, service: str, asked: dict[str, Any]) -> dict[str, Any]:
        kind = _type(asked["type"])
        client = self.clients.get(service) or self.node.create_client(kind, service)
        self.clients[service] = client
        self._spin_until(client.service_is_ready)
        future = client.call_async(_message(kind.Request, asked["values"]))
        self._spin_until(future.done)
        return {"answer": _values(future.result())}

    def _spin_until(self, condition: Any) -> None:
        deadline = time.monotonic() + _LIMIT_S
        while not condition():
            assert time.monotonic() < deadline, "waited in vain"
            rclpy.spin_once(self.node, timeout_sec=0.01)


def _type(name: str) -> Any:
    package, kind, one = name.split("/")
    return getattr(import_module(f"{package}.{kind}"), one)


def _message(kind: Any, values: dict[str, Any]) -> Any:
    message = kind()
    for name, value in values.items():
        here = getattr(message, name)
        if isinstance(value, dict):
            value = _message(type(here), value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            inner = message.get_fields_and_field_types()[name]
            package, one = inner.removeprefix("sequence<").removesuffix(">").split("/")
            value = [_message(_type(f"{package}/msg/{one}"), part) for part in value]
        setattr(message, name, value)
    return message


def _values(message: Any) -> Any:
    if hasattr(message, "get_fields_and_field_types"):
        return {name: _values(getattr(message, name)) for name in message.get_fields_and_field_types()}
    if isinstance(message, bytes):
        return message[0]
    if isinstance(message, str | bool | int | float):
        return message
    return [_values(one) for one in message]


def main() -> None:
    """Answer lines until there are no more."""
    peer = Peer()
    while True:
        rclpy.spin_once(peer.node, timeout_sec=0.005)
        if select.select([sys.stdin], [], [], 0)[0]:
            line = sys.stdin.readline()
            if not line:
                return
            print(json.dumps(peer.handle(json.loads(line))), flush=True)


if __name__ == "__main__":
    main()
