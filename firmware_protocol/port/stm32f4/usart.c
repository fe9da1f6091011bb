#include "usart.h"

#include "interrupts.h"
#include "pins.h"
#include "registers/core.h"
#include "registers/rcc.h"

typedef struct {
    usart_registers *registers;
    volatile uint32_t *clock_register;
    uint32_t clock_bit;
    uint8_t interrupt;
    bool on_apb2;
} usart_hardware;

#define USART_COUNT 6u

static const usart_hardware hardware[USART_COUNT] = {
    {USART1, &RCC->APB2ENR, RCC_APB2ENR_USART1, USART1_IRQ, true},
    {USART2, &RCC->APB1ENR, RCC_APB1ENR_USART2, USART2_IRQ, false},
    {USART3, &RCC->APB1ENR, RCC_APB1ENR_USART3, USART3_IRQ, false},
    {UART4, &RCC->APB1ENR, RCC_APB1ENR_UART4, UART4_IRQ, false},
    {UART5, &RCC->APB1ENR, RCC_APB1ENR_UART5, UART5_IRQ, false},
    {USART6, &RCC->APB2ENR, RCC_APB2ENR_USART6, USART6_IRQ, true},
};

static usart *lines[USART_COUNT]; /* who owns which; a closed one has no interrupts */

void usart_open(usart *line, const board_serial *settings, const clock_tree *clocks) {
    const usart_hardware *own = &hardware[settings->usart - 1u];
    const uint32_t bus_hz = own->on_apb2 ? clocks->apb2_hz : clocks->apb1_hz;
    line->registers = own->registers;
    lines[settings->usart - 1u] = line;
    clock_enable(own->clock_register, own->clock_bit);
    pin_to_peripheral(settings->transmit);
    pin_to_peripheral(settings->receive);
    line->registers->BRR = (bus_hz + settings->baud / 2u) / settings->baud;
    line->registers->CR1 = USART_CR1_UE | USART_CR1_TE | USART_CR1_RE | USART_CR1_RXNEIE;
    interrupt_enable(own->interrupt);
}

/* Hands over what the transmitter takes; the interrupt goes on until the ring is empty. */
static void transmit(usart *line) {
    usart_registers *r = line->registers;
    while ((r->SR & USART_SR_TXE) != 0u && line->sending_tail != line->sending_head) {
        r->DR = line->sending[line->sending_tail % USART_SENDING];
        line->sending_tail++;
    }
    if (line->sending_tail != line->sending_head) {
        r->CR1 |= USART_CR1_TXEIE;
    } else {
        r->CR1 &= ~USART_CR1_TXEIE;
    }
}

static void receive(usart *line) {
    usart_registers *r = line->registers;
    uint32_t status;
    while (((status = r->SR) & (USART_SR_RXNE | USART_SR_ORE)) != 0u) {
        const uint8_t byte = (uint8_t)r->DR; /* clears both flags */
        const bool full = line->received_head - line->received_tail == USART_RECEIVED;
        if ((status & USART_SR_ORE) != 0u || full) {
            line->overruns++;
        }
        if ((status & USART_SR_RXNE) != 0u && !full) {
            line->received[line->received_head % USART_RECEIVED] = byte;
            line->received_head++;
        }
    }
}

static void interrupt(usart *line) {
    receive(line);
    transmit(line);
}

void usart1_interrupt(void) {
    interrupt(lines[0]);
}

void usart2_interrupt(void) {
    interrupt(lines[1]);
}

void usart3_interrupt(void) {
    interrupt(lines[2]);
}

void uart4_interrupt(void) {
    interrupt(lines[3]);
}

void uart5_interrupt(void) {
    interrupt(lines[4]);
}

void usart6_interrupt(void) {
    interrupt(lines[5]);
}

bool usart_receive(usart *line, uint8_t *byte) {
    if (line->received_tail == line->received_head) {
        return false;
    }
    *byte = line->received[line->received_tail % USART_RECEIVED];
    line->received_tail++;
    return true;
}

bool usart_has_received(const usart *line) {
    return line->received_tail != line->received_head;
}

size_t usart_room(const usart *line) {
    return USART_SENDING - (line->sending_head - line->sending_tail);
}

void usart_send(usart *line, const uint8_t *bytes, size_t length) {
    for (size_t i = 0; i < length; i++) {
        line->sending[(line->sending_head + i) % USART_SENDING] = bytes[i];
    }
    interrupts_off();
    line->sending_head += length;
    transmit(line);
    interrupts_on();
}
