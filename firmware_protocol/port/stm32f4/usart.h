/* Serial lines: 8 bits, no parity, one stop bit, both directions by interrupt through rings.
 *
 * Interrupts and not DMA: the emulated targets have no DMA, and what runs there is what runs on a chip. A
 * received byte waits for at most two byte times, 10 us at 2,000,000 baud, before the next is lost, which is
 * why every interrupt is short and interrupts are never off for long. One thing is longer: while a word of
 * the flash is programmed, 16 to 100 us, the core stands still, and so a STORE may cost bytes. They are
 * counted, the plant is asked again, and a STORE bars arming.
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
