"""An STM32F405 in software: Unicorn's Cortex-M4, and a model of each peripheral that the firmware touches.

Unicorn executes the instructions; everything around the core is here, a file a peripheral, written from the reference
manual RM0090 and the ARMv7-M manual: ``nvic`` (exceptions), ``core_clock`` (SysTick, cycle counter), ``rcc``,
``flash``, ``usart``, ``can``, ``timer``, ``watchdog`` and ``gpio``; ``stm32f405`` puts them together. Time is what the
chip is told: ``Stm32f405.advance`` lets it pass, reading a clock costs a few cycles, instructions none. So the same
input gives the same output, bit for bit, on every run.

What is not modelled is listed in firmware_protocol/TARGETS.md.
"""
