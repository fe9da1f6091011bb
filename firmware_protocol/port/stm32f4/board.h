/* What differs from board to board, as data. A board is one file of boards/; every build links exactly one.
 *
 * All boards carry an STM32F405 or a larger chip of its family. Pins and alternate functions are those of its
 * data sheet, table 9.
 */
#ifndef STM32F4_BOARD_H
#define STM32F4_BOARD_H

#include <stdbool.h>
#include <stdint.h>

#include "../../firmware/node.h"

/* cffi: begin */
enum { PORT_A, PORT_B, PORT_C, PORT_D, PORT_E };

typedef struct {
    uint8_t port;
    uint8_t number;
    uint8_t alternate; /* function; 0 for a plain input or output */
} pin;

/* The crystal drives the oscillator at crystal / divider * multiplier, 336 MHz; half of it is the core clock.
 */
typedef struct {
    uint8_t divider;
    uint16_t multiplier;
} board_oscillator;

typedef struct {
    uint8_t usart; /* 1 to 6 */
    uint32_t baud;
    pin transmit;
    pin receive;
} board_serial;

/* A bit has 1 + bs1 + bs2 quanta, each of `prescaler` periods of the 42 MHz bus clock. */
typedef struct {
    pin transmit;
    pin receive;
    uint16_t prescaler;
    uint8_t bs1;
    uint8_t bs2;
    uint8_t sjw;
} board_can;

typedef struct {
    uint8_t number; /* told in HELLO_FIRMWARE.board; 0 is the host library */
    board_oscillator oscillator;
    board_serial host_serial;
    board_can host_can;
    wheel_parameters parameters;     /* built in */
    const wheel_parameters *maximum; /* what the hardware stands; NULL where it is simulated */
} board;

extern const board BOARD;
/* cffi: end */

/* A hardware-in-the-loop board has this too: the second serial line, with the plant at its other end. */
/* cffi: begin */
extern const board_serial PLANT_LINE;
/* cffi: end */

#endif
