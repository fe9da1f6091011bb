#include "pins.h"

#include "registers/gpio.h"
#include "registers/rcc.h"

static void put(volatile uint32_t *word, uint32_t at, uint32_t bits, uint32_t value) {
    const uint32_t mask = ((1u << bits) - 1u) << (at * bits);
    *word = (*word & ~mask) | (value << (at * bits));
}

static gpio_registers *port_of(pin which) {
    clock_enable(&RCC->AHB1ENR, RCC_AHB1ENR_GPIO(which.port));
    return GPIO(which.port);
}

static void to_alternate(pin which, uint32_t pull) {
    gpio_registers *gpio = port_of(which);
    put(&gpio->AFR[which.number / 8u], which.number % 8u, 4, which.alternate);
    put(&gpio->OSPEEDR, which.number, 2, GPIO_SPEED_HIGH);
    put(&gpio->PUPDR, which.number, 2, pull);
    put(&gpio->MODER, which.number, 2, GPIO_MODE_ALTERNATE);
}

void pin_to_peripheral(pin which) {
    to_alternate(which, GPIO_PULL_UP);
}

void pin_to_bridge(pin which) {
    to_alternate(which, GPIO_PULL_DOWN);
}

void pin_to_analog(pin which) {
    put(&port_of(which)->MODER, which.number, 2, GPIO_MODE_ANALOG);
}

void pin_output(pin which) {
    gpio_registers *gpio = port_of(which);
    pin_write(which, false); /* before the mode: no pulse */
    put(&gpio->MODER, which.number, 2, GPIO_MODE_OUTPUT);
}

void pin_write(pin which, bool high) {
    GPIO(which.port)->BSRR = 1u << (which.number + (high ? 0u : 16u));
}

bool pin_is_high(pin which) {
    return (GPIO(which.port)->ODR >> which.number & 1u) != 0u;
}
