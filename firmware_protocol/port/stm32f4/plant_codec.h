/* The plant port's second serial line: its frames, without I/O.
 *
 * Framing is that of the host's line, COBS(id16 LE | sequence8 | payload | CRC16-CCITT-FALSE LE) 00, with
 * identifiers beyond the 11 bits of wheel.dbc, so that no frame of one line passes on the other, and payloads
 * of up to 76 bytes: the fields of plant_port.h in their order, little-endian, floats as their binary32 bits.
 *
 *   801 SAMPLE  to the plant, 4 bytes:   tick. Answered by SENSE with this tick; no time passes.
 *   802 DRIVE   to the plant, 40 bytes:  wheel_drive. The plant holds it for one millisecond and answers with
 *                                        SENSE of the next tick. Repeated with the tick of the last one, it
 *                                        is answered again and no time passes.
 *   803 SENSE   to the robot, 76 bytes:  wheel_sense.
 *
 * The other end is plant_port.py.
 */
#ifndef STM32F4_PLANT_CODEC_H
#define STM32F4_PLANT_CODEC_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../../firmware/cobs.h"
#include "../../firmware/plant_port.h"

/* cffi: begin */
enum { PLANT_SAMPLE_ID = 0x801, PLANT_DRIVE_ID = 0x802, PLANT_SENSE_ID = 0x803 };
enum { PLANT_SAMPLE_LENGTH = 4, PLANT_DRIVE_LENGTH = 40, PLANT_SENSE_LENGTH = 76 };
/* id, sequence, payload, CRC; and with what COBS adds and the zero. */
enum { PLANT_BODY_MAX = 81, PLANT_FRAME_MAX = 83 };

typedef struct {
    uint8_t buffer[82]; /* PLANT_FRAME_MAX without the zero */
    uint8_t length;
    bool overrun; /* the open frame is too long and is dropped up to its zero */
} plant_deframer;

/* Takes one byte, whatever it is; true when it completes a valid SENSE. Anything else is dropped: the drive
 * is then sent again. */
bool plant_deframer_feed(plant_deframer *deframer, uint8_t byte, wheel_sense *sense);

/* Both write a frame with its zero into PLANT_FRAME_MAX bytes and return its length. `sequence` counts the
 * frames of this line. */
size_t plant_encode_sample(uint32_t tick, uint8_t sequence, uint8_t *out);
size_t plant_encode_drive(const wheel_drive *drive, uint8_t sequence, uint8_t *out);
/* cffi: end */

_Static_assert(PLANT_BODY_MAX == 2 + 1 + PLANT_SENSE_LENGTH + 2, "id, sequence, payload, CRC");
_Static_assert(PLANT_FRAME_MAX == WHEEL_COBS_MAX(PLANT_BODY_MAX) + 1u, "COBS and the zero");

#endif
