"""A CAN frame, written out bit by bit (ISO 11898-1): what it takes on the bus."""

FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
ENDING = "1" + "01" + "1111111" + "111"  # CRC delimiter, acknowledgement, end of frame, intermission


def crc15(bits: str) -> str:
    """Polynomial division on the whole number at once: x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1."""
    divisor = int("1100010110011001", 2)
    rest = int(bits + "0" * 15, 2)
    while rest.bit_length() > 15:
        rest ^= divisor << (rest.bit_length() - 16)
    return f"{rest:015b}"


def stuffed(bits: str, *, at_end: bool) -> str:
    """Return what a transmitter puts on the bus: after five bits alike, stuff bits counted, one of the other kind."""
    out = ""
    for place, bit in enumerate(bits):
        out += bit
        if out[-5:] in ("00000", "11111") and (at_end or place + 1 < len(bits)):
            out += "10"[int(bit)]
    return out


def octet_bits(payload: bytes) -> str:
    """Return the bits of bytes, the highest first."""
    return "".join(f"{byte:08b}" for byte in payload)


def classic_frame(number: int, payload: bytes, *, extended: bool = False, remote_length: int | None = None) -> str:
    """Return the bits of a classic frame; ``remote_length`` is what a remote frame asks for."""
    remote = "0" if remote_length is None else "1"
    length = len(payload) if remote_length is None else remote_length
    identifier = f"{number:029b}" if extended else f"{number:011b}"
    head = f"0{identifier[:11]}" + (f"11{identifier[11:]}{remote}00" if extended else f"{remote}00")
    body = head + f"{length:04b}" + octet_bits(payload)
    return stuffed(body + crc15(body), at_end=True) + ENDING


def fd_lengths(number: int, payload: bytes, *, extended: bool, switched: bool) -> tuple[int, int]:
    """Return how many bits of an FD frame go at the nominal rate, and how many at that of the data.

    The nominal one is up to the bit that switches, and from the CRC delimiter on. The CRC is stuffed evenly.
    """
    identifier = f"{number:029b}" if extended else f"{number:011b}"
    ide = "11" + identifier[11:] + "0" if extended else "00"
    arbitration = "0" + identifier[:11] + ide + "1" + "0" + str(int(switched))
    body = arbitration + "0" + f"{FD_LENGTHS.index(len(payload)):04b}" + octet_bits(payload)
    crc = 4 + (17 if len(payload) <= 16 else 21)
    total = len(stuffed(body, at_end=False)) + crc + -(-crc // 4) + len(ENDING)
    # A stuff bit that follows the switch belongs to the phase that it is in.
    slow = len(stuffed(arbitration, at_end=False)) + len(ENDING) - 1
    return (slow, total - slow) if switched else (total, 0)
