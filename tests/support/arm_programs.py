"""Small programs for the STM32F405, compiled by the cross compiler for tests of the machine alone."""

import shutil
import subprocess
from pathlib import Path

COMPILER = "arm-none-eabi-gcc"
HAS_COMPILER = shutil.which(COMPILER) is not None
NEEDS_COMPILER = "needs arm-none-eabi-gcc; install gcc-arm-none-eabi and libnewlib-arm-none-eabi"

_FLAGS = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-O2", "-ffp-contract=off")
_BEFORE = """
#include <stdint.h>
#define REGISTER(address) (*(volatile uint32_t *)(address))
#define WAIT() __asm volatile("wfi" ::: "memory")
#define OFF() __asm volatile("cpsid i" ::: "memory")
#define ON() __asm volatile("cpsie i" ::: "memory")
/* Where a program leaves what it found out; zero at the start. */
#define result ((volatile uint32_t *)0x20000000)
"""
_START = """
#include <stdint.h>
int main(void);
void fault(void) { __asm volatile("bkpt 0"); for (;;) {} }
#define HANDLER(name) __attribute__((weak, alias("fault"))) void name(void)
HANDLER(systick); HANDLER(usart1); HANDLER(usart2); HANDLER(can_tx); HANDLER(can_rx); HANDLER(can_error); HANDLER(tim2);
static void reset(void) { *(volatile uint32_t *)0xE000ED88 |= 0xF << 20; main(); fault(); }
__attribute__((section(".vectors"), used)) static void (*const vectors[16 + 82])(void) = {
    (void (*)(void))0x20020000, reset, fault, fault, fault, fault, fault, [11] = fault, [14] = fault, [15] = systick,
    [16 + 19] = can_tx, [16 + 20] = can_rx, [16 + 22] = can_error, [16 + 28] = tim2, [16 + 37] = usart1,
    [16 + 38] = usart2,
};
"""
RESULT = 0x2000_0000


def compile_program(folder: Path, body: str) -> Path:
    """Compile and link a program with its startup. It has no initialised data; ``result`` lies at RESULT."""
    sources = folder / "program.c", folder / "start.c"
    for path, text in zip(sources, (_BEFORE + body, _START), strict=True):
        path.write_text(text)
    places = {".vectors": 0x0800_0000, ".text": 0x0800_0400, ".bss": RESULT + 0x100}
    layout = [f"-Wl,--section-start={name}={address:#x}" for name, address in places.items()]
    program = folder / "program.elf"
    command = [COMPILER, *_FLAGS, "-Wall", "-nostdlib", *layout, "-Wl,-e,main", "-o", program, *sources]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return program
