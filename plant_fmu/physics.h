/* What an instance asks of its physics. The linker decides which: mecanum_physics.c in the shipped FMU, or
 * mujoco/physics.c in MuJoCo's.
 *
 * A function that returns false has reported why through plant_fail or plant_discard. */
#ifndef PLANT_PHYSICS_H
#define PLANT_PHYSICS_H

#include "hidden.h"
#include "instance.h"

HIDDEN_BEGIN

/* Makes the state at the start from the parameters. */
bool physics_start(plant_instance *plant);

/* Number of equal internal steps in a communication step. */
double physics_internal_steps(plant_instance *plant, double step_s);

/* Advances the state in that many internal steps, with the inputs held. After a failure the state is as it
 * was, so that it may be discarded. */
bool physics_advance(plant_instance *plant, double step_s, double internal_steps);

/* Makes the outputs from the state, the inputs and the parameters. */
bool physics_output(plant_instance *plant);

/* Frees what the physics keeps outside the snapshot, if anything. */
void physics_release(plant_instance *plant);

HIDDEN_END

#endif
