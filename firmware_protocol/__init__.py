"""The wheel-command protocol and its firmware. Imports nothing else of this project.

``wheel.dbc`` defines the messages and ``PROTOCOL.md`` explains them; ``generated`` holds the codecs generated from
``wheel.dbc``; ``codec`` turns messages into frames, ``framing`` frames into bytes. None of them does any I/O.
"""
