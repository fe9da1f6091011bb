/* One instance of the plant as a co-simulation slave: its mode, its variables by value reference, its time.
 *
 * Free of any FMI version; fmi2.c and fmi3.c add the names and types of theirs. Every function that can fail
 * reports the reason through `report` and returns false: an error puts the instance into PLANT_ERROR, a
 * discarded call leaves it as it was (FMI 2.0 section 2.1.3, FMI 3.0 section 2.2.3). No statics: instances
 * are independent. */
#ifndef PLANT_INSTANCE_H
#define PLANT_INSTANCE_H

#include <stddef.h>

/* Defines mecanum_state, the state of the physics as plain data. */
#ifndef PLANT_STATE_HEADER
#define PLANT_STATE_HEADER "mecanum.h"
#endif
#include PLANT_STATE_HEADER
#include "hidden.h"

HIDDEN_BEGIN

/* Modes are bits, so that the modes in which a call is legal are one mask. */
typedef enum {
    PLANT_INSTANTIATED = 1,
    PLANT_INITIALIZATION = 2,
    PLANT_STEP_COMPLETE = 4,
    PLANT_TERMINATED = 8,
    PLANT_ERROR = 16,
    PLANT_ANY = 31,
} plant_mode;

/* Types are bits, because FMI 2.0 reads enumerations as integers and FMI 3.0 does not. */
typedef enum { PLANT_REAL = 1, PLANT_INTEGER = 2, PLANT_ENUMERATION = 4 } plant_type;

/* All that a saved state has to hold. */
typedef struct {
    plant_mode mode;
    bool experiment_defined;
    bool stop_defined;
    bool outputs_stale;
    double time_s;
    double stop_s;
    mecanum_state state;
    mecanum_parameters parameters;
    mecanum_inputs inputs;
    mecanum_outputs outputs;
} plant_snapshot;

/* Says why a call failed; `discarded` tells which way. */
typedef void (*plant_report)(void *owner, bool discarded, const char *text);

typedef struct {
    plant_snapshot now;
    void *physics; /* what the physics keeps beside the state, NULL for nothing; no part of a saved state */
    plant_report report;
    void *owner;
} plant_instance;

/* Puts start values everywhere and the mode to PLANT_INSTANTIATED; also, after physics_release, what a reset
 * does. */
void plant_init(plant_instance *plant, plant_report report, void *owner);

/* Reports an error, enters PLANT_ERROR and returns false. */
bool plant_fail(plant_instance *plant, const char *format, ...);

/* Reports that the call is discarded and returns false; the caller has changed nothing. */
bool plant_discard(plant_instance *plant, const char *format, ...);

/* The same, and the reason may be values that are far from usual: it names them. */
bool plant_discard_extreme(plant_instance *plant, const char *format, ...);

/* Tells whether a call that has failed was discarded. */
bool plant_has_discarded(const plant_instance *plant);

/* Tells whether `call` is legal now; fails when it is not. `modes` is a mask. */
bool plant_allows(plant_instance *plant, unsigned modes, const char *call);

bool plant_setup(plant_instance *plant, double start_s, bool stop_defined, double stop_s);
bool plant_enter_initialization(plant_instance *plant);
bool plant_exit_initialization(plant_instance *plant);
bool plant_terminate(plant_instance *plant);

/* `types` is a mask; `values` are doubles for PLANT_REAL and int32_t for the others. Until initialization
 * mode only variables with a start value can be read. Values are set all or none: one that is out of its
 * range has the call discarded. */
bool plant_get(plant_instance *plant, unsigned types, const unsigned references[], size_t count,
               void *values);
bool plant_set(plant_instance *plant, unsigned types, const unsigned references[], size_t count,
               const void *values);

/* Tells whether plant_set would set these values; reports like it when it would not. */
bool plant_may_set(plant_instance *plant, unsigned types, const unsigned references[], size_t count,
                   const void *values);

/* Steps from `from_s`, which must be where the instance is, by `step_s` in equal internal steps. A step that
 * needs too many of them, or does not stay finite, is discarded. */
bool plant_step(plant_instance *plant, double from_s, double step_s);

HIDDEN_END

#endif
