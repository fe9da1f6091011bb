"""The wheel-command protocol and the firmware that speaks it. Imports nothing else of this project.

``wheel.dbc`` defines the wire and ``PROTOCOL.md`` explains it; ``generated`` holds the codecs made from the
former, ``codec`` and ``framing`` turn messages into frames and frames into bytes, without any I/O.
"""
