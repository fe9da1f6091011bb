/* Advanced-control timers (RM0090, 17.3.9 to 17.3.12). */
#include "pwm.h"

#include "motor_board.h"
#include "pins.h"
#include "registers/rcc.h"
#include "registers/timer.h"

#define TIMERS 2u
static timer_registers *const timers[TIMERS] = {TIM1, TIM8};

static timer_registers *timer_of(const motor_output *motor) {
    return motor->timer == 1u ? TIM1 : TIM8;
}

/* The two timers are alike, and one that drives nothing has no outputs: both are set up. */
static void open_timer(timer_registers *timer, uint32_t period) {
    timer->CR1 = TIMER_CR1_CENTRE | TIMER_CR1_ARPE;
    timer->ARR = period;
    timer->BDTR = TIMER_BDTR_OSSI | TIMER_BDTR_LOCK1 | MOTORS.dead_time;
}

static void open_channel(const motor_output *motor) {
    timer_registers *timer = timer_of(motor);
    const uint32_t index = motor->channel - 1u;
    const bool complementary = MOTORS.kind == MOTOR_COMPLEMENTARY;
    timer->CCMR[index / 2u] |= (TIMER_CCMR_PWM1 | TIMER_CCMR_PRELOAD) << (8u * (index % 2u));
    timer->CCER |= (TIMER_CCER_E | (complementary ? TIMER_CCER_NE : 0u)) << (4u * index);
}

void pwm_open(const clock_tree *clocks) {
    pin_output(MOTORS.enable);
    RCC->APB2ENR |= RCC_APB2ENR_TIM1 | RCC_APB2ENR_TIM8;
    for (size_t i = 0; i < TIMERS; i++) {
        /* Both timers count at the core's clock, once up and once down a period. */
        open_timer(timers[i], clocks->core_hz / (2u * MOTORS.pwm_hz));
    }
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        open_channel(&MOTORS.motor[i]);
    }
    for (size_t i = 0; i < TIMERS; i++) {
        timers[i]->EGR = TIMER_EGR_UG;
        timers[i]->CR1 |= TIMER_CR1_CEN;
    }
    /* Only now, with the timers holding their outputs low. */
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        const motor_output *motor = &MOTORS.motor[i];
        pin_to_bridge(motor->first);
        if (MOTORS.kind == MOTOR_COMPLEMENTARY) {
            pin_to_bridge(motor->second);
        } else {
            pin_output(motor->second);
        }
    }
}

/* Written so that a duty that is no number gives zero volt. */
static float limited(float duty) {
    return duty >= -1.0f ? (duty <= 1.0f ? duty : 1.0f) : (duty < -1.0f ? -1.0f : 0.0f);
}

static void set(const motor_output *motor, float wish) {
    timer_registers *timer = timer_of(motor);
    const float duty = motor->reversed ? -limited(wish) : limited(wish);
    const float period = (float)timer->ARR;
    float on;
    if (MOTORS.kind == MOTOR_COMPLEMENTARY) {
        on = period * (0.5f + 0.5f * duty);
    } else {
        /* The sign may be up to one PWM period ahead of the magnitude, which is small when the sign changes.
         */
        pin_write(motor->second, duty >= 0.0f);
        on = period * (duty < 0.0f ? -duty : duty);
    }
    timer->CCR[motor->channel - 1u] = (uint32_t)(on + 0.5f);
}

void pwm_drive(const float duty[4]) {
    const bool was_off = (timer_of(&MOTORS.motor[0])->BDTR & TIMER_BDTR_MOE) == 0u;
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        set(&MOTORS.motor[i], duty[i]);
    }
    if (was_off) {
        for (size_t i = 0; i < TIMERS; i++) {
            timers[i]->EGR = TIMER_EGR_UG; /* these duties from the first period on */
            timers[i]->BDTR |= TIMER_BDTR_MOE;
        }
        pin_write(MOTORS.enable, true);
    }
}

void pwm_off(void) {
    for (size_t i = 0; i < TIMERS; i++) {
        timers[i]->BDTR &= ~TIMER_BDTR_MOE;
    }
    pin_write(MOTORS.enable, false);
}
