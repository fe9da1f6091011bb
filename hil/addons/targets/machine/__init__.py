"""An STM32F405 in software: Unicorn's Cortex-M4, and a model of each peripheral that the firmware touches.

Unicorn executes the instructions. Everything around the core is here, written from the reference manual RM0090 and the
ARMv7-M manual: ``peripherals`` (the base class and the small ones), ``can``, ``flash``, ``nvic`` (exceptions); ``core``
takes exceptions, and ``stm32f405`` puts all together. To add a peripheral, give its registers to a subclass of
``Peripheral``, and its address to ``stm32f405``. Time passes only by ``Stm32f405.advance`` and a few cycles for each
reading of a clock, so the same input always gives the same output, bit for bit.

firmware_protocol/TARGETS.md lists what is not modelled.
"""
