/* Currents, battery and temperatures: ADC 1 converts its channels over and over, DMA keeps the newest rounds.
 */
#ifndef STM32F4_ANALOG_H
#define STM32F4_ANALOG_H

#include <stdbool.h>

#include "clock.h"

void analog_open(void);

/* Takes what the four current inputs give now, with the bridges off, for zero. False when one of them is far
 * from its nominal zero: a sensor or its supply is broken. Takes 5 ms. */
bool analog_calibrate(void);

/* False when conversions were lost or stopped, so that the values are old, and when an input is outside the
 * range that its sensor gives. To be called once a tick. */
bool analog_is_good(void);

/* Means over the last 0.2 ms, which is some whole PWM periods. A current is positive when it drives its wheel
 * forward. */
void analog_currents(float current_a[4]);
float analog_battery_v(void);

/* 0 where the board has no sensors. */
void analog_temperatures(float temperature_degc[4]);

#endif
