/* The chip's own supply. */
#ifndef STM32F4_SUPPLY_H
#define STM32F4_SUPPLY_H

/* Waits until the supply is above 2.8 V, which programming the flash and the clock need 2.7 V of. From then
 * on a supply that sinks ends in fault(): the motors go off, and the chip starts again when the supply is
 * back. */
void supply_open(void);

#endif
