"""Robots whose firmware is executed by Unicorn, for tests of the STM32F405's drivers."""

import functools
import itertools
import struct

from tests.support.arm_firmwares import firmware
from tests.support.arm_machine import GPIO, RAM, Machine

GPIO_END = 0x4002_2400
ADC_SR, ADC_CR2 = 0x4001_2000, 0x4001_2008
DMA_NDTR = 0x4002_6414
ROUNDS = 7
CAN, CAN_TSR = 0x4000_6400, 0x4000_6408
IWDG_KR, IWDG_RLR = 0x4000_3000, 0x4000_3008
RAW_ZERO = round(1.6667 / 3.3 * 4095)  # of a current sensor
ROUND = [RAW_ZERO] * 4 + [2700] + [930] * 4  # currents, battery of 24 V, temperatures of 25 degC
SCRATCH = RAM + 0x1_8000  # beyond all variables


def machine(variant: str, board: str, link: str = "serial") -> Machine:
    """Return a machine with this firmware, in reset."""
    return Machine(firmware(variant, board, link).elf)


@functools.cache
def _booted(board: str, link: str) -> tuple:
    own = machine("motors", board, link)
    _convert(own)
    own.reactions[ADC_CR2] = lambda _: own.write(own.symbols["analog"], struct.pack("<63H", *ROUND * ROUNDS))  # by DMA
    own.poke(CAN_TSR, 1 << 27)
    own.boot()
    return own, own.save()


def _convert(own: Machine) -> None:
    """Let the DMA of the converter go round."""
    left = itertools.cycle(range(9 * ROUNDS, 0, -5))
    own.answers[DMA_NDTR] = lambda: next(left)


def with_motors(board: str, link: str = "serial") -> Machine:
    """Return a robot with motors that stands there in IDLE; on CAN, with the second mailbox free."""
    own, state = _booted(board, link)
    own.restore(state)
    _convert(own)
    return own


def bits_of(name: str) -> tuple[int, int]:
    """Return the base address of a pin's port, and its number."""
    return GPIO + 0x400 * "ABCDE".index(name[0]), int(name[1:])
