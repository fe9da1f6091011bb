"""Acceptance filters: nothing of ours is lost, whatever the identifiers, and little else passes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.generated.messages import SENDERS
from hil.wire.can_bus import Filter, filters_for

IDENTIFIERS = range(2048)


@pytest.mark.parametrize(("sender", "most", "foreign"), [("ROBOT", 8, 3), ("HOST", 8, 0), ("ROBOT", 1, 2048 - 20)])
def test_of_all_identifiers_ours_pass_and_few_others(sender, most, foreign):
    ours = {number for number, who in SENDERS.items() if who == sender}
    filters = filters_for(ours, most)
    passing = {number for number in IDENTIFIERS if any(f.passes(number) for f in filters)}
    assert len(filters) <= most
    assert ours <= passing
    assert len(passing - ours) <= foreign


@given(st.sets(st.integers(0, 2047), min_size=1, max_size=24), st.integers(1, 10))
def test_whatever_the_identifiers_none_is_lost_and_the_number_is_kept(ours, most):
    filters = filters_for(ours, most)
    assert 1 <= len(filters) <= most
    assert all(any(f.passes(number) for f in filters) for number in ours)


@given(st.sets(st.integers(0, 2047), min_size=1, max_size=8))
def test_with_a_filter_each_nothing_else_passes(ours):
    filters = filters_for(ours, len(ours))
    assert {number for number in IDENTIFIERS if any(f.passes(number) for f in filters)} == ours


@given(st.integers(0, 2047), st.integers(0, 2047), st.integers(0, 2047))
def test_a_filter_is_python_cans(identifier, mask, probe):
    """The oracle is python-can's own matching of a frame with a filter."""
    import can

    ours = Filter(identifier & mask, mask)
    row = {"can_id": ours.identifier, "can_mask": ours.mask, "extended": False}
    with can.Bus(interface="virtual", channel="filters", can_filters=[row]) as bus:
        message = can.Message(arbitration_id=probe, is_extended_id=False)
        assert ours.passes(probe) == bus._matches_filters(message)
        assert ours.width == sum(ours.passes(number) for number in IDENTIFIERS)
