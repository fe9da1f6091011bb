/* ADC 1 with DMA 2, stream 0, channel 0 (RM0090, 13.8 and table 43). */
#include "analog.h"

#include <stddef.h>

#include "motor_board.h"
#include "pins.h"
#include "registers/adc.h"
#include "registers/rcc.h"
#include "uptime.h"

#define REFERENCE_V 3.3f
#define FULL_SCALE 4095.0f
/* A conversion takes 68 periods of 21 MHz, so that seven rounds of nine channels take 0.204 ms: four PWM
 * periods at 20 kHz and five at 25 kHz, over which the ripple is nothing, and short enough for the current
 * loop. */
#define ROUNDS 7u
#define BATTERY_AT WHEEL_COUNT
#define TEMPERATURE_AT (WHEEL_COUNT + 1u)
#define INPUTS (2u * WHEEL_COUNT + 1u)
/* How far from its nominal zero a current sensor may be: it is half of a supply of 5 V, 5 % of which are
 * 0.083 V behind the divider; 1 % each of divider and reference are 0.033 V. */
#define ZERO_TOLERANCE_V 0.12f
/* A tick may find the DMA where the last one did, as it goes round; one that stands still is found there
 * again and again. */
#define LOOKS_IN_ONE_PLACE 2u
#define SETTLING_MS 5u

static struct {
    volatile uint16_t sample[ROUNDS][INPUTS];
    float zero_v[WHEEL_COUNT];
    uint32_t transfers_left; /* of this round, when last looked at */
    uint32_t looks;          /* since that changed */
} analog;

static const analog_input *input_at(size_t index) {
    if (index < BATTERY_AT) {
        return &MOTORS.current[index];
    }
    return index == BATTERY_AT ? &MOTORS.battery : &MOTORS.temperature[index - TEMPERATURE_AT];
}

/* Without temperature sensors their places in the round convert the battery again. */
static const analog_input *converted_at(size_t index) {
    return input_at(index >= TEMPERATURE_AT && !MOTORS.has_temperatures ? BATTERY_AT : index);
}

static void open_input(size_t index) {
    const analog_input *input = converted_at(index);
    const uint32_t channel = input->channel;
    pin_to_analog(input->input);
    if (channel < 10u) {
        ADC1->SMPR2 |= ADC_SMPR_56_CYCLES << (3u * channel);
    } else {
        ADC1->SMPR1 |= ADC_SMPR_56_CYCLES << (3u * (channel - 10u));
    }
    ADC1->SQR[2u - index / 6u] |= channel << (5u * (index % 6u));
}

void analog_open(void) {
    clock_enable(&RCC->AHB1ENR, RCC_AHB1ENR_DMA2);
    clock_enable(&RCC->APB2ENR, RCC_APB2ENR_ADC1);
    DMA2_STREAM0->PAR = (uint32_t)(uintptr_t)&ADC1->DR;
    DMA2_STREAM0->M0AR = (uint32_t)(uintptr_t)analog.sample;
    DMA2_STREAM0->NDTR = ROUNDS * INPUTS;
    DMA2_STREAM0->CR = DMA_CR_16_BITS | DMA_CR_MINC | DMA_CR_CIRC | DMA_CR_EN;
    ADC_COMMON_CCR = ADC_CCR_DIV4;
    ADC1->CR1 = ADC_CR1_SCAN;
    ADC1->SQR[0] = (INPUTS - 1u) << 20;
    for (size_t i = 0; i < INPUTS; i++) {
        open_input(i);
    }
    ADC1->CR2 = ADC_CR2_ADON | ADC_CR2_CONT | ADC_CR2_DMA | ADC_CR2_DDS;
    /* The converter needs 3 us after it was switched on (data sheet, table 67). */
    const uint32_t began_us = uptime_us();
    while (uptime_us() - began_us < 10u) {
    }
    ADC1->CR2 |= ADC_CR2_SWSTART;
}

static float volts_at(size_t index) {
    uint32_t sum = 0;
    for (size_t i = 0; i < ROUNDS; i++) {
        sum += analog.sample[i][index];
    }
    return (float)sum * (REFERENCE_V / (FULL_SCALE * (float)ROUNDS));
}

static float value_at(size_t index, float zero_v) {
    return (volts_at(index) - zero_v) * input_at(index)->per_v;
}

bool analog_calibrate(void) {
    const uint32_t began_ms = uptime_ms();
    while (uptime_ms() - began_ms < SETTLING_MS) {
    }
    bool good = analog_is_good();
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        const float off_v = volts_at(i) - MOTORS.current[i].zero_v;
        good = good && off_v < ZERO_TOLERANCE_V && off_v > -ZERO_TOLERANCE_V;
        analog.zero_v[i] = MOTORS.current[i].zero_v + off_v;
    }
    return good;
}

static bool is_running(void) {
    const uint32_t left = DMA2_STREAM0->NDTR;
    analog.looks = left == analog.transfers_left ? analog.looks + 1u : 0u;
    analog.transfers_left = left;
    return (ADC1->SR & ADC_SR_OVR) == 0u && analog.looks <= LOOKS_IN_ONE_PLACE;
}

bool analog_is_good(void) {
    bool good = is_running();
    for (size_t i = 0; i < INPUTS; i++) {
        const float volts = volts_at(i);
        good = good && volts >= converted_at(i)->least_v && volts <= converted_at(i)->most_v;
    }
    return good;
}

void analog_currents(float current_a[4]) {
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        const float measured_a = value_at(i, analog.zero_v[i]);
        current_a[i] = MOTORS.motor[i].reversed ? -measured_a : measured_a;
    }
}

float analog_battery_v(void) {
    return value_at(BATTERY_AT, MOTORS.battery.zero_v);
}

void analog_temperatures(float temperature_degc[4]) {
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        const size_t at = TEMPERATURE_AT + i;
        temperature_degc[i] = MOTORS.has_temperatures ? value_at(at, MOTORS.temperature[i].zero_v) : 0.0f;
    }
}
