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
    timer->BDTR = TIMER_BDTR_OSSI | TIMER_BDTR_BREAK | TIMER_BDTR_LOCK1 | MOTORS.dead_time;
}

static void open_channel(const motor_output *motor) {
    timer_registers *timer = timer_of(motor);
    const uint32_t index = motor->channel - 1u;
    const bool complementary = MOTORS.kind == MOTOR_COMPLEMENTARY;
    timer->CCMR[index / 2u] |= (TIMER_CCMR_PWM1 | TIMER_CCMR_PRELOAD) << (8u * (index % 2u));
    timer->CCER |= (TIMER_CCER_E | (complementary ? TIMER_CCER_NE : 0u)) << (4u * index);
}

void pwm_open(const clock_tree *clocks) {
    pwm_off();
    clock_enable(&RCC->APB2ENR, RCC_APB2ENR_TIM1 | RCC_APB2ENR_TIM8);
    for (size_t i = 0; i < TIMERS; i++) {
        /* Both timers count at the core's clock, once up and once down a period. */
        open_timer(timers[i], clocks->core_hz / (2u * MOTORS.pwm_hz));
    }
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        open_channel(&MOTORS.motor[i]);
    }
    for (size_t i = 0; i < TIMERS; i++) {
        timers[i]->EGR = TIMER_EGR_UG;
        timers[i]->SR = 0; /* no break so far; one that lasts sets its flag again */
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
    const float most = MOTORS.duty_limit;
    return duty >= -most ? (duty <= most ? duty : most) : (duty < -most ? -most : 0.0f);
}

/* Without preload the zero is in force at once, so that the old magnitude never meets the new sign; the new
 * magnitude comes with the next half period. */
static void turn_round(const motor_output *motor, bool forward) {
    timer_registers *timer = timer_of(motor);
    const uint32_t index = motor->channel - 1u;
    const uint32_t preload = TIMER_CCMR_PRELOAD << (8u * (index % 2u));
    timer->CCMR[index / 2u] &= ~preload;
    timer->CCR[index] = 0;
    pin_write(motor->second, forward);
    timer->CCMR[index / 2u] |= preload;
}

static void set(const motor_output *motor, float wish) {
    timer_registers *timer = timer_of(motor);
    const float duty = motor->reversed ? -wish : wish;
    const float period = (float)timer->ARR;
    float on;
    if (MOTORS.kind == MOTOR_COMPLEMENTARY) {
        on = period * (0.5f + 0.5f * duty);
    } else {
        const bool forward = duty >= 0.0f;
        if (forward != pin_is_high(motor->second)) {
            turn_round(motor, forward);
        }
        on = period * (forward ? duty : -duty);
    }
    timer->CCR[motor->channel - 1u] = (uint32_t)(on + 0.5f);
}

bool pwm_has_broken(void) {
    const uint32_t one = TIM1->SR;
    return ((one | TIM8->SR) & TIMER_SR_BIF) != 0u;
}

void pwm_drive(float duty[4]) {
    const bool broken = pwm_has_broken(); /* of one timer alone: the other wheels would drive on */
    const bool was_off = (TIM1->BDTR & TIM8->BDTR & TIMER_BDTR_MOE) == 0u;
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        duty[i] = broken ? 0.0f : limited(duty[i]);
        set(&MOTORS.motor[i], duty[i]);
    }
    if (broken) {
        pwm_off();
    } else if (was_off) {
        for (size_t i = 0; i < TIMERS; i++) {
            timers[i]->EGR = TIMER_EGR_UG; /* these duties from the first period on */
            timers[i]->BDTR |= TIMER_BDTR_MOE;
        }
        pin_write(MOTORS.enable, true);
    }
}

void pwm_off(void) {
    for (size_t i = 0; i < TIMERS; i++) {
        /* A timer without a clock reads zero. BDTR is not written before pwm_open: its first write is the one
         * that locks (RM0090, 17.4.18). */
        if ((timers[i]->BDTR & TIMER_BDTR_MOE) != 0u) {
            timers[i]->BDTR &= ~TIMER_BDTR_MOE;
        }
    }
    pin_output(MOTORS.enable);
}
