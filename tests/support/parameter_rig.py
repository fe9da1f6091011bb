"""What tests of the parameters share: their rows, their bits on the wire, and a request with its answer."""

import struct

from firmware_protocol.generated import messages as m
from firmware_protocol.generated.messages import Operation, Type
from firmware_protocol.host import Parameter, parameters
from tests.support.bare_node import BareNode
from tests.support.wheel_rig import WheelRig

ROWS = parameters()


def bits(row: Parameter, value: float) -> int:
    """The value as it crosses the wire."""
    return int(value) if row.type is Type.UINT32 else int(struct.unpack("<I", struct.pack("<f", value))[0])


def single(value: float) -> float:
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def ask(
    node: WheelRig | BareNode, operation: Operation, index: int = 0, value: int = 0, transaction: int = 7
) -> m.ParameterResponse:
    """Return the answer to a request, of which there is one."""
    node.heard()
    node.send(m.ParameterRequest(index, operation, transaction, value))
    (answer,) = [x for x in node.heard() if isinstance(x, m.ParameterResponse)]
    assert answer.transaction == transaction
    assert (answer.operation, answer.parameter) == (operation, index)
    return answer
