/* One instance of the plant as a co-simulation slave: its mode, its variables by value reference, its time.
 *
 * Free of any FMI version; fmi2.c and fmi3.c add the names and types of theirs. Every function that can fail
 * reports the reason through `report`, puts the instance into PLANT_ERROR and returns false (FMI 2.0 section
 * 4.2.4, FMI 3.0 section 2.2.3). No statics: instances are independent. */
#ifndef PLANT_INSTANCE_H
#define PLANT_INSTANCE_H

#include <stddef.h>

/* Defines mecanum_state, the state of the physics as plain data. */
#ifndef PLANT_STATE_HEADER
#define PLANT_STATE_HEADER "mecanum.h"
#endif
#include PLANT_STATE_HEADER

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

typedef struct {
    plant_snapshot now;
    void *physics; /* what the physics keeps beside the state, NULL for nothing; no part of a saved state */
    void (*report)(void *owner, const char *text);
    void *owner;
} plant_instance;

/* Puts start values everywhere and the mode to PLANT_INSTANTIATED; also, after plant_release, what a reset
 * does. */
void plant_init(plant_instance *plant, void (*report)(void *owner, const char *text), void *owner);

/* Frees what belongs to the instance, not the instance. */
void plant_release(plant_instance *plant);

/* Reports, enters PLANT_ERROR and returns false. */
bool plant_fail(plant_instance *plant, const char *format, ...);

/* Tells whether `call` is legal now; fails when it is not. `modes` is a mask. */
bool plant_allows(plant_instance *plant, unsigned modes, const char *call);

bool plant_setup(plant_instance *plant, double start_s, bool stop_defined, double stop_s);
bool plant_enter_initialization(plant_instance *plant);
bool plant_exit_initialization(plant_instance *plant);
bool plant_terminate(plant_instance *plant);

/* `types` is a mask; `values` are doubles for PLANT_REAL and int32_t for the others. Until initialization
 * mode only variables with a start value can be read. */
bool plant_get(plant_instance *plant, unsigned types, const unsigned references[], size_t count,
               void *values);
bool plant_set(plant_instance *plant, unsigned types, const unsigned references[], size_t count,
               const void *values);

/* Steps from `from_s`, which must be where the instance is, by `step_s` in equal internal steps. */
bool plant_step(plant_instance *plant, double from_s, double step_s);

#endif
