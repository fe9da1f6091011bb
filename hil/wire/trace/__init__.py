"""Traces of the bus in the files of other tools: ``session`` writes them, ``decode`` reads them in our terms."""

from hil.wire.trace.session import Trace, TracedWire, TraceReport

__all__ = ["Trace", "TraceReport", "TracedWire"]
