"""Links and what happens on them: URLs, transports, framing, latency, faults, statistics, traces (LINKS.md).

May import: `faults`, `record`, `core`, `firmware_protocol`.
To add a transport: one file here, its URL in `url.py`, its two ends in `opening.py`.
"""
