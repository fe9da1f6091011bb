"""The codecs made from wheel.dbc by `python -m firmware_protocol.generate`; do not edit."""
