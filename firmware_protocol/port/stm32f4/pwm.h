/* The bridges of four motors: PWM of timers 1 and 8, and the pin that enables them. */
#ifndef STM32F4_PWM_H
#define STM32F4_PWM_H

#include <stdbool.h>

#include "clock.h"

/* Prepares the timers with all outputs low and the bridges off. */
void pwm_open(const clock_tree *clocks);

/* Duties FL, FR, RR, RL from the next half PWM period on, after limiting them to what the board drives;
 * switches the bridges on. Off and zero after a break. */
void pwm_drive(float duty[4]);

/* A break has switched the outputs of a timer off; they stay off until a reset. */
bool pwm_has_broken(void);

/* All outputs low within a few nanoseconds, and the bridges off. Works at any time, also as the first thing
 * after a reset. */
void pwm_off(void);

#endif
