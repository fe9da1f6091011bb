/* What the two parts of the FMI 3.0 interface share. */
#ifndef FMI3_SLAVE_H
#define FMI3_SLAVE_H

#include "fmi3.h"
#include "hidden.h"
#include "instance.h"

HIDDEN_BEGIN

/* Where variables can be read and set: FMI 3.0 sections 2.3 and 4.2. In the instantiated state only start
 * values can be read, which plant_get sees to. */
enum {
    FMI3_IN_GET = PLANT_ANY,
    FMI3_IN_SET = PLANT_INSTANTIATED | PLANT_INITIALIZATION | PLANT_STEP_COMPLETE,
};

/* Returns the plant when the call is legal now, else reports it and returns NULL. */
plant_instance *fmi3_legal(fmi3Instance instance, unsigned modes, const char *call);

/* Says why there is no instance, whatever loggingOn says: the importer has nothing else to go by. Returns
 * NULL. */
fmi3Instance fmi3_no_instance(fmi3LogMessageCallback log_message, fmi3InstanceEnvironment environment,
                              fmi3String text);

HIDDEN_END

#endif
