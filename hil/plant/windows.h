/* Steps an FMU through many short stretches of time, each from its own start: one C call for all of them.
 *
 * A case is a window (its rows of torques) with a set of start values. For each case the FMU is reset, given
 * its start values, initialised and stepped. The steps are those of cosim.c, so they give the same bits.
 */
#ifndef COSIM_WINDOWS_H
#define COSIM_WINDOWS_H

#include "cosim.h"

/* cffi: begin */
typedef struct { /* start values of one type that are the same in all cases */
    cosim_function call;
    const unsigned *reference;
    size_t references;
    const void *value; /* of that type */
} cosim_setting;

typedef struct {
    cosim_function reset;
    cosim_function setup_experiment; /* NULL with FMI 3.0 */
    cosim_function enter_initialization;
    cosim_function exit_initialization;

    const cosim_setting *setting;
    size_t settings;
    const cosim_variable *varied; /* what differs from case to case */
    size_t varieds;
    const size_t *output; /* of the enumeration of signals */
    size_t outputs;
    size_t rows; /* of every window */

    const float *torque_n_m; /* windows x rows x 4, FL, FR, RR, RL */
    const size_t *window;    /* of each case */
    const double *start;     /* cases x varieds */
    double *result;          /* cases x (rows + 1) x outputs: at the start, and at the end of each row */
    size_t cases;
    size_t failed_case; /* set when a call returns 1 */
} cosim_windows;

/* Steps all cases. Returns 0, or 1 when the FMU failed in `failed_case`; then `text` of the cosim says why.
 */
int cosim_run_windows(cosim *c, cosim_windows *w);
/* cffi: end */

#endif
