"""Links to robots: URLs, transports, framing, latency, faults, statistics and traces (LINKS.md).

May import: `faults`, `record`, `core`, `firmware_protocol`.
To add a kind of link: a subclass of `LinkUrl` (`link.py`), and an entry point of `hil.links` in pyproject.toml; another
package does the same.
"""
