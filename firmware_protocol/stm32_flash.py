"""The parameters that an STM32 keeps across a reset, as bytes of its flash (``port/stm32f4/parameter_log.h``)."""

from binascii import crc_hqx

PARAMETER_ADDRESS = 0x0804_0000
"""Sector 6: start of the first of the two parameter sectors."""
SECTOR_BYTES = 128 * 1024
HIL_BOARD = 1
"""Number of the board in ``port/stm32f4/boards/hil_f405.c`` (DBC HELLO_FIRMWARE.board)."""

_RECORD_BYTES = 128
_CHECK_AT = 116  # CRC-16 over the stored bytes
_MARK_AT = 120  # sequence number and its complement


def flash_image(stored: bytes) -> bytes:
    """Return the record that a first STORE of these bytes leaves at ``PARAMETER_ADDRESS``.

    ``stored`` are the bytes of the core (``wheel_parameters_store``; ``HostNode.stored``). The rest of both sectors is
    erased flash, FF. Raises ValueError when the bytes do not fit into a record.
    """
    if len(stored) > _CHECK_AT:
        raise ValueError(f"{len(stored)} stored bytes: expected at most {_CHECK_AT}")
    sequence = 0
    mark = sequence.to_bytes(4, "little") + (sequence ^ 0xFFFF_FFFF).to_bytes(4, "little")
    return stored.ljust(_CHECK_AT, b"\xff") + _check(stored) + mark


def newest_stored(sectors: bytes, size: int) -> bytes | None:
    """Return the ``size`` bytes of the newest intact record in both sectors, or None when there is none."""
    newest, found = -1, None
    for at in range(0, len(sectors) - _RECORD_BYTES + 1, _RECORD_BYTES):
        mark = sectors[at + _MARK_AT : at + _RECORD_BYTES]
        sequence, complement = (int.from_bytes(mark[n : n + 4], "little") for n in (0, 4))
        stored = sectors[at : at + size]
        is_whole = sequence ^ complement == 0xFFFF_FFFF and sectors[at + _CHECK_AT : at + _MARK_AT] == _check(stored)
        if is_whole and sequence > newest:
            newest, found = sequence, stored
    return found


def _check(stored: bytes) -> bytes:
    return crc_hqx(stored, 0xFFFF).to_bytes(4, "little")
