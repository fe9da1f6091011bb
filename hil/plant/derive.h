/* What the shim makes of an FMU's outputs before the bridge sees them: angles without jumps, and what the FMU
 * has no variable for. All of it happens in `fresh`. */
#ifndef DERIVE_H
#define DERIVE_H

#include <stdbool.h>

#include "cosim.h"

/* Takes the angles as they are: no turns have been counted. */
void cosim_start_winding(cosim *c);

/* Adds the turns that the FMU took off the heading, and off the wheel angles where something follows from
 * them. */
void cosim_unwind(cosim *c);

/* Fills in what the FMU has no variable for. `passed` tells whether a step has since `signal`. */
void cosim_derive(cosim *c, bool passed);

#endif
