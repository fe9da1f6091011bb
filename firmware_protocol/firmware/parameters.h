/* What the firmware runs with. Parameters change in IDLE only; the host compares their hash before it arms.
 */
#ifndef WHEEL_PARAMETERS_H
#define WHEEL_PARAMETERS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../generated/wheel_parameters.h"

/* cffi: begin */
typedef struct {
    const char *name;
    uint8_t type; /* of the value on the wire, enum wp_type */
    float minimum;
    float maximum;
} wheel_parameter_info;

/* cffi: end */

/* The parameters in the order of wheel_parameters, which is the order of their hash. */
extern const wheel_parameter_info wheel_parameter_table[WHEEL_PARAMETER_COUNT];

/* What a port keeps across a reset: a mark, the hash of the table, the board, the number of parameters, their
 * values, and a CRC-32 over all. */
#define WHEEL_STORED_SIZE (12u + 4u * WHEEL_PARAMETER_COUNT + 4u)

float wheel_parameter_get(const wheel_parameters *parameters, size_t index);

/* The end of a parameter's range: the table's, or the board's where that is smaller. `board_maximum` are the
 * greatest values that the board's hardware stands, NULL for those of the table. */
float wheel_parameter_maximum(const wheel_parameters *board_maximum, size_t index);

/* False, and nothing changed, unless the value is a number within its range. */
bool wheel_parameter_set(wheel_parameters *parameters, const wheel_parameters *board_maximum, size_t index,
                         float value);

/* The value as it crosses the wire, and back; false when these bits are no value of the parameter's type. */
uint32_t wheel_parameter_bits(size_t index, float value);
bool wheel_parameter_from_bits(size_t index, uint32_t bits, float *value);

void wheel_parameters_store(const wheel_parameters *parameters, uint16_t board,
                            uint8_t bytes[WHEEL_STORED_SIZE]);

/* False, and nothing changed, unless the bytes are whole, of this table and this board, and every value is in
 * its range. */
bool wheel_parameters_load(wheel_parameters *parameters, const wheel_parameters *board_maximum,
                           uint16_t board, const uint8_t bytes[WHEEL_STORED_SIZE]);

/* cffi: begin */
/* Index of the first parameter that is not finite or out of its range, or -1 when all are good. */
int wheel_parameters_invalid(const wheel_parameters *parameters);

/* CRC-32 (IEEE 802.3) over the values as little-endian binary32, in the order of the table. */
uint32_t wheel_parameters_hash(const wheel_parameters *parameters);
/* cffi: end */

#endif
