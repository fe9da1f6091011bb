/* What the two parts of the FMI 2.0 interface share. */
#ifndef FMI2_SLAVE_H
#define FMI2_SLAVE_H

#include "fmi2.h"
#include "hidden.h"
#include "instance.h"

HIDDEN_BEGIN

/* Where each call is legal: FMI 2.0 section 4.2.4, the table of the state machine. */
enum {
    FMI2_IN_SET = PLANT_INSTANTIATED | PLANT_INITIALIZATION | PLANT_STEP_COMPLETE,
    FMI2_IN_GET = PLANT_INITIALIZATION | PLANT_STEP_COMPLETE | PLANT_TERMINATED | PLANT_ERROR,
    FMI2_IN_STATUS = PLANT_STEP_COMPLETE | PLANT_TERMINATED | PLANT_ERROR,
};

/* Returns the plant when the call is legal now, else reports it and returns NULL. */
plant_instance *fmi2_legal(fmi2Component c, unsigned modes, const char *call);

HIDDEN_END

#endif
