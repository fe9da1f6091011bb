/* Encoder interface mode (RM0090, 18.3.12). */
#include "encoders.h"

#include "motor_board.h"
#include "pins.h"
#include "registers/rcc.h"
#include "registers/timer.h"

#define FILTER 3u /* 8 equal samples at 84 MHz: pulses below 95 ns are noise */

static timer_registers *timer_of(const motor_encoder *encoder) {
    static timer_registers *const timers[] = {TIM2, TIM3, TIM4, TIM5};
    return timers[encoder->timer - 2u];
}

static void open(const motor_encoder *encoder) {
    timer_registers *timer = timer_of(encoder);
    clock_enable(&RCC->APB1ENR, RCC_APB1ENR_TIM(encoder->timer));
    pin_to_peripheral(encoder->a); /* pulled up, for open collectors */
    pin_to_peripheral(encoder->b);
    timer->ARR = 0xFFFFu; /* 16 bits also of the two timers that have 32 */
    timer->CCMR[0] =
        (TIMER_CCMR_INPUT | TIMER_CCMR_FILTER(FILTER)) | (TIMER_CCMR_INPUT | TIMER_CCMR_FILTER(FILTER)) << 8;
    timer->CCER = encoder->reversed ? TIMER_CCER_P : 0u;
    timer->SMCR = TIMER_SMCR_ENCODER;
    timer->CR1 = TIMER_CR1_CEN;
}

void encoders_open(void) {
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        open(&MOTORS.encoder[i]);
    }
}

void encoders_read(uint16_t count[4]) {
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        count[i] = (uint16_t)timer_of(&MOTORS.encoder[i])->CNT;
    }
}
