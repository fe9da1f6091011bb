"""The parts that every page of ours shares: its frame and style, and pictures.

May import: `core`, `record`.
"""
