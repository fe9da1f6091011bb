/* The floor that every importer is measured against: a C loop over an FMU's own functions, and nothing else.
 */
#ifndef RAW_LOOP_H
#define RAW_LOOP_H

#include <stddef.h>

/* cffi: begin */
typedef void (*raw_function)(void);

typedef struct {
    void *component;
    int fmi_version;                                       /* 2 or 3 */
    raw_function set_real, get_real, get_integer, do_step; /* fmi2..., or fmi3...Float64 and fmi3...Int32 */
    unsigned input[16];
    double value[16];
    size_t inputs;
    unsigned real[32];
    size_t reals;
    unsigned integer[32];
    size_t integers;
    unsigned long step_ms;
} raw_loop;

/* Takes so many steps from time 0. Returns the worst status, 0 when all went well. */
int raw_run(const raw_loop *loop, unsigned long steps);
/* cffi: end */

#endif
