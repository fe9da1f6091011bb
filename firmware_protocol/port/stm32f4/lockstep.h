/* Robot time from STEP. Motor builds do not link this: without the capability the core refuses STEP. */
#ifndef STM32F4_LOCKSTEP_H
#define STM32F4_LOCKSTEP_H

#include "robot.h"

/* Runs the ticks that a STEP asks for, if one does. */
__attribute__((weak)) void lockstep_serve(robot *r);

#endif
