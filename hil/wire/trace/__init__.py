"""Traces: files of all frames on a link, for bus tools. ``session`` writes them, ``decode`` reads and decodes them."""

from hil.wire.trace.session import Trace, TracedWire, TraceReport

__all__ = ["Trace", "TraceReport", "TracedWire"]
