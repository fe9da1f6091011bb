/* Serial lines: 8 bits, no parity, one stop bit, both directions by interrupt through rings.
 *
 * Interrupts and not DMA: the emulated targets have no DMA, and what runs there is what runs on a chip. A
 * byte costs about 0.4 us of the core, so that two lines at 2,000,000 baud with the traffic of a 1 kHz loop
 * take some 15 % of it. A byte waits for at most two of them before the next is lost, which is why no
 * interrupt is longer than that and interrupts are never off for longer.
 */
#ifndef STM32F4_USART_H
#define STM32F4_USART_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "board.h"
#include "clock.h"
#include "registers/usart.h"

#define USART_RECEIVED 1024u /* both are powers of two */
#define USART_SENDING 2048u

typedef struct {
    usart_registers *registers;
    volatile uint8_t received[USART_RECEIVED];
    volatile uint32_t received_head; /* counts up for ever */
    volatile uint32_t received_tail;
    volatile uint8_t sending[USART_SENDING];
    volatile uint32_t sending_head;
    volatile uint32_t sending_tail;
    volatile uint32_t overruns; /* times that received bytes were lost, here or in the peripheral */
} usart;

/* Opens a line; `line` belongs to the caller and stays where it is. */
void usart_open(usart *line, const board_serial *settings, const clock_tree *clocks);

/* Takes the next received byte; false when there is none. */
bool usart_receive(usart *line, uint8_t *byte);
bool usart_has_received(const usart *line);

/* How many bytes usart_send takes now. */
size_t usart_room(const usart *line);

/* Sends bytes for which there is room. */
void usart_send(usart *line, const uint8_t *bytes, size_t length);

#endif
