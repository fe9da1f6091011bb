"""Flash memory and its interface (RM0090, chapter 3): programming clears bits, erasing a sector sets them.

Sectors that the image does not use are registers to the machine, so that a store to them arrives here.
"""

from hil.addons.targets.machine.peripherals import MachineError, Peripheral

BASE = 0x0800_0000
SIZE = 0x0010_0000
SECTORS = (*[0x4000] * 4, 0x1_0000, *[0x2_0000] * 7)

ACR, KEYR, OPTKEYR, SR, CR, OPTCR = 0x00, 0x04, 0x08, 0x0C, 0x10, 0x14
_KEYS = (0x4567_0123, 0xCDEF_89AB)
_PG, _SER, _MER, _START, _LOCK = 1 << 0, 1 << 1, 1 << 2, 1 << 16, 1 << 31
_EOP, _WRITE_PROTECTED, _PARALLELISM, _SEQUENCE = 1 << 0, 1 << 4, 1 << 6, 1 << 7
_ERASED = 0xFF


class FlashMemory:
    """The bytes of the flash, erased."""

    def __init__(self) -> None:
        self.bytes = bytearray([_ERASED]) * SIZE

    def load(self, address: int, data: bytes) -> None:
        """Put an image's bytes at an address, as a programmer does. Raises MachineError outside the flash."""
        offset = address - BASE
        if not 0 <= offset <= SIZE - len(data):
            raise MachineError(f"{len(data)} bytes at {address:#010x} are not within the flash of {SIZE >> 10} KiB")
        self.bytes[offset : offset + len(data)] = data

    def read(self, address: int, size: int) -> bytes:
        """Return bytes of the flash."""
        return bytes(self.bytes[address - BASE : address - BASE + size])


def region(sector: int) -> tuple[int, int]:
    """Return address and size of a sector."""
    return BASE + sum(SECTORS[:sector]), SECTORS[sector]


def sectors_of(address: int, size: int) -> set[int]:
    """Return the sectors that ``size`` bytes at ``address`` touch."""
    regions = [region(sector) for sector in range(len(SECTORS))]
    return {n for n, (start, length) in enumerate(regions) if address < start + length and start < address + size}


class FlashInterface(Peripheral):
    """The registers. ``protected`` are the sectors of the running image."""

    def __init__(self, memory: FlashMemory, protected: set[int]) -> None:
        super().__init__("FLASH", {ACR: 0, KEYR: 0, OPTKEYR: 0, SR: 0, CR: _LOCK, OPTCR: 0x0FFF_AAED})
        self._memory = memory
        self._protected = protected

    def reset(self) -> None:
        super().reset()
        self._keys_seen = 0

    def write(self, offset: int, value: int) -> None:
        if offset == KEYR:
            if self._keys_seen < 2 and value == _KEYS[self._keys_seen]:
                self._keys_seen += 1
            else:
                self._keys_seen = 3  # a wrong key locks until the next reset
            if self._keys_seen == 2:
                self._register[CR] &= ~_LOCK
                self._keys_seen = 0
        elif offset == SR:
            self._register[SR] &= ~value
        elif offset == CR:
            if self._register[CR] & _LOCK:
                raise MachineError("the flash is locked: write the two keys to KEYR before CR")
            self._register[CR] = value & ~_START
            if value & _START:
                self._erase(value)
        else:
            super().write(offset, value)

    def program(self, address: int, size: int, value: int) -> None:
        """Store ``size`` bytes, as a store instruction to the flash does. Bits only go from 1 to 0."""
        control = self._register[CR]
        if control & _LOCK or not control & _PG:
            self._register[SR] |= _SEQUENCE
            return
        if size != 1 << (control >> 8 & 3):
            self._register[SR] |= _PARALLELISM
            return
        offset = address - BASE
        old = int.from_bytes(self._memory.bytes[offset : offset + size], "little")
        self._memory.bytes[offset : offset + size] = (old & value).to_bytes(size, "little")
        self._register[SR] |= _EOP

    def _erase(self, control: int) -> None:
        sector = control >> 3 & 0xF
        if control & _MER or not control & _SER or sector >= len(SECTORS):
            raise MachineError(f"FLASH_CR = {control:#010x} does not erase one sector, the only erasure modelled here")
        if sector in self._protected:
            self._register[SR] |= _WRITE_PROTECTED
            return
        start, size = region(sector)
        self._memory.load(start, bytes([_ERASED]) * size)
        self._register[SR] |= _EOP
