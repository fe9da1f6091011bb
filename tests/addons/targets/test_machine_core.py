"""The emulated core: programs of the cross compiler, interrupted where a Cortex-M4 would be."""

import struct
from pathlib import Path

import pytest

pytest.importorskip("unicorn", reason="needs the extra 'targets': pip install 'mecanum-hil[targets]'")

from hil.addons.targets.machine.peripherals import MachineError
from hil.addons.targets.machine.stm32f405 import CORE_HZ, Stm32f405
from tests.support.arm_programs import HAS_COMPILER, NEEDS_COMPILER, RESULT, compile_program

pytestmark = pytest.mark.skipif(not HAS_COMPILER, reason=NEEDS_COMPILER)

OPEN_USART1 = """
    REGISTER(0x4001100C) = 1 << 13 | 1 << 5 | 1 << 3 | 1 << 2;
    REGISTER(0xE000E104) = 1 << 5;
"""
ECHO = """
volatile uint32_t interrupts;
void usart1(void) {
    interrupts++;
    while (REGISTER(0x40011000) & 0x20) { REGISTER(0x40011004) = REGISTER(0x40011004) + 1; }
    result[0] = interrupts;
}
"""


def results(machine: Stm32f405, count: int = 4) -> tuple[int, ...]:
    return struct.unpack(f"<{count}I", machine.memory(RESULT, 4 * count))


def test_a_burst_of_bytes_is_one_interrupt_and_comes_back(tmp_path: Path):
    image = compile_program(tmp_path, ECHO + "int main(void) {" + OPEN_USART1 + "for (;;) WAIT(); }")
    with Stm32f405(image) as machine:
        machine.run()
        assert machine.usart[1].receive(b"abc")
        machine.run()
        assert machine.usart[1].sent == b"bcd"
        assert results(machine, 1) == (1,)


def test_an_interrupt_that_is_masked_comes_when_it_is_unmasked(tmp_path: Path):
    """The sleep of a main loop: interrupts off, look, WFI wakes all the same, interrupts on."""
    body = """
    for (;;) { OFF(); WAIT(); result[1] = interrupts; ON(); __asm volatile("isb"); result[2] = interrupts; }"""
    image = compile_program(tmp_path, ECHO + "int main(void) {" + OPEN_USART1 + body + "}")
    with Stm32f405(image) as machine:
        machine.run()
        machine.usart[1].receive(b"x")
        machine.run()
        assert results(machine, 3) == (1, 0, 1)


@pytest.mark.parametrize("instruction", ["msr primask, %0", "msr basepri, %0"])
def test_every_way_to_unmask_lets_the_interrupt_in(tmp_path: Path, instruction: str):
    body = f"""
    uint32_t off = {1 if "primask" in instruction else 0x10}, on = 0;
    REGISTER(0xE000E424) = 0x40 << 8;
    __asm volatile("{instruction}" ::"r"(off));
    REGISTER(0xE000E204) = 1 << 5;
    result[1] = interrupts;
    (void)REGISTER(0x40011000);
    result[2] = interrupts;
    __asm volatile("{instruction}" ::"r"(on));
    __asm volatile("isb");
    result[3] = interrupts;
    for (;;) WAIT();"""
    image = compile_program(tmp_path, ECHO + "int main(void) {" + OPEN_USART1 + body + "}")
    with Stm32f405(image) as machine:
        machine.run()
        assert results(machine) == (1, 0, 0, 1)


def test_registers_and_floats_survive_interrupts_at_every_register_access(tmp_path: Path):
    """A sum over register accesses, with an interrupt before each that uses integers and floats."""
    body = """
volatile float noise;
void tim2(void) { REGISTER(0x40000010) = 0; noise = noise * 1.5f + 2.0f; if (noise > 1e6f) noise = 0.5f; result[5]++; }
int main(void) {
    REGISTER(0x4000000C) = 1;
    REGISTER(0xE000E100) = 1 << 28;
    float sum = 0.0f, step = 0.25f;
    uint32_t mix = 1;
    for (uint32_t i = 0; i < 500; i++) {
        REGISTER(0x40000014) = 1; /* an update: the interrupt is due */
        mix = mix * 1664525u + REGISTER(0x40000028) + i;
        sum = sum * 0.5f + step * (float)(mix >> 20);
    }
    result[0] = mix;
    union { float f; uint32_t u; } bits = {.f = sum};
    result[1] = bits.u;
    for (;;) WAIT();
}"""
    with Stm32f405(compile_program(tmp_path, body)) as machine:
        machine.run()
        mix, bits, _, _, _, taken = results(machine, 6)
    expected, total = 1, 0.0
    for i in range(500):
        expected = (expected * 1664525 + i) & 0xFFFFFFFF
        term = struct.unpack("<f", struct.pack("<f", 0.25 * struct.unpack("<f", struct.pack("<f", expected >> 20))[0]))[
            0
        ]
        total = struct.unpack("<f", struct.pack("<f", total * 0.5 + term))[0]
    assert mix == expected
    assert struct.unpack("<f", struct.pack("<I", bits))[0] == total
    assert taken == 500


def test_a_more_urgent_interrupt_nests_and_a_less_urgent_one_waits(tmp_path: Path):
    body = (
        """
static volatile uint32_t depth;
void usart1(void) {
    depth++;
    result[0] = depth;
    (void)REGISTER(0x40011004);
    REGISTER(0xE000E200) = 1 << 28;  /* TIM2, more urgent */
    REGISTER(0xE000E204) = 1 << 6;   /* USART2, less */
    (void)REGISTER(0x40011000);
    result[3] = REGISTER(0xE000ED04) & 0x1FF;
    depth--;
}
void tim2(void) { depth++; result[1] = depth; result[4] = REGISTER(0xE000ED04) & 0x1FF; depth--; }
void usart2(void) { depth++; result[2] = depth; depth--; }
int main(void) {
    REGISTER(0xE000E100) = 1 << 28;
    REGISTER(0xE000E41C) = 0x10;
    REGISTER(0xE000E424) = 0x20 << 8 | 0x30 << 16;"""
        + OPEN_USART1
        + """
    REGISTER(0xE000E104) = 1 << 6;
    for (;;) WAIT();
}"""
    )
    with Stm32f405(compile_program(tmp_path, body)) as machine:
        machine.run()
        machine.usart[1].receive(b"x")
        machine.run()
        assert results(machine, 5) == (1, 2, 1, 16 + 37, 16 + 28)


def test_systick_fires_once_a_period_of_the_time_that_passes(tmp_path: Path):
    body = """
void systick(void) { result[0]++; }
int main(void) {
    REGISTER(0xE000E014) = 168000 - 1;
    REGISTER(0xE000E018) = 0;
    REGISTER(0xE000E010) = 7;
    for (;;) WAIT();
}"""
    with Stm32f405(compile_program(tmp_path, body)) as machine:
        machine.run()
        for _ in range(10):
            machine.advance(CORE_HZ // 1000)
            machine.run()
        assert results(machine, 1) == (10,)


def test_a_watchdog_that_is_not_fed_resets_the_machine_and_says_so(tmp_path: Path):
    body = """
int main(void) {
    result[0]++;
    result[1] = REGISTER(0x40023874) >> 24;
    REGISTER(0x40003000) = 0x5555;
    REGISTER(0x40003008) = 31; /* 32 periods of 125 us: 4 ms */
    REGISTER(0x40003000) = 0xCCCC;
    for (;;) WAIT();
}"""
    with Stm32f405(compile_program(tmp_path, body)) as machine:
        machine.run()
        machine.advance(CORE_HZ * 3 // 1000)
        machine.run()
        assert (machine.resets, results(machine, 2)) == (0, (1, 0x0C))
        machine.advance(CORE_HZ // 1000)
        machine.run()
        assert (machine.resets, results(machine, 2)) == (1, (2, 0x2C))


def test_a_reset_that_the_firmware_asks_for_starts_it_anew(tmp_path: Path):
    body = "int main(void) { if (++result[0] < 3) { REGISTER(0xE000ED0C) = 0x05FA0004; for (;;) {} } for (;;) WAIT(); }"
    with Stm32f405(compile_program(tmp_path, body)) as machine:
        machine.run()
        assert machine.resets == 2
        assert results(machine, 1) == (3,)


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("REGISTER(0x40012000);", "the firmware read 0x40012000, which this machine does not model"),
        ("REGISTER(0x40011040) = 1;", "USART1 has no register at offset 0x040"),
        ("*(volatile uint16_t *)0x40011002 = 1;", "wrote 2 bytes at 0x40011002; registers are written as words; at"),
        ("REGISTER(0x60000000) = 1;", "wrote 4 bytes at 0x60000000, where nothing answers"),
        ("REGISTER(0x08000000) = 1;", "wrote 4 bytes at 0x08000000, where nothing answers"),
        ('__asm volatile("udf #1");', "the firmware crashed: Invalid instruction (UC_ERR_INSN_INVALID); at"),
        ('__asm volatile("bkpt 0");', "the firmware took a breakpoint; at"),
    ],
)
def test_what_a_board_would_crash_at_is_told_with_its_place(tmp_path: Path, body: str, said: str):
    with Stm32f405(compile_program(tmp_path, "int main(void) {" + body + "for (;;) WAIT(); }")) as machine:
        with pytest.raises(MachineError, match=r"main|fault") as told:
            machine.run()
        assert said in str(told.value)


def test_firmware_that_never_waits_is_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("hil.addons.targets.machine.core.RUNAWAY_S", 0.2)
    machine = Stm32f405(compile_program(tmp_path, "int main(void) { for (;;) {} }"))
    with machine, pytest.raises(MachineError, match=r"without waiting; it is at 0x0800\w+ \(main"):
        machine.run()


def test_parameters_in_flash_obey_the_laws_of_flash(tmp_path: Path):
    """Locked until unlocked; a bit goes from 1 to 0 only; an erased sector is all ones."""
    body = """
#define WORD REGISTER(0x08040000)
int main(void) {
    WORD = 0x12345678; /* locked: nothing happens, and an error is flagged */
    result[0] = WORD; result[1] = REGISTER(0x40023C0C);
    REGISTER(0x40023C04) = 0x45670123; REGISTER(0x40023C04) = 0xCDEF89AB;
    REGISTER(0x40023C0C) = 0xFF; REGISTER(0x40023C10) = 1 | 2 << 8;
    WORD = 0x0F0F0F0F; WORD = 0x00FFFF00;
    result[2] = WORD;
    REGISTER(0x40023C10) = 2 | 6 << 3 | 1 << 16;
    result[3] = WORD;
    for (;;) WAIT();
}"""
    with Stm32f405(compile_program(tmp_path, body)) as machine:
        machine.run()
        assert results(machine) == (0xFFFFFFFF, 0x80, 0x000F0F00, 0xFFFFFFFF)
