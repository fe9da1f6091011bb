/* The robot's body, as the node's plant port has it (plant_port.h): what it senses once a tick, and the set
 * points of its drives. plant_motors.c has motors; plant_line.c, of the hardware-in-the-loop builds, has a
 * serial line with a simulated body at its other end.
 */
#ifndef STM32F4_PLANT_H
#define STM32F4_PLANT_H

#include "../../firmware/node.h"
#include "clock.h"

typedef enum { PLANT_READY, PLANT_WAITING, PLANT_FAILED } plant_answer;

/* WHEEL_CAPABILITY_* of this body. */
uint16_t plant_capabilities(void);

/* Starts with the drives off. */
void plant_open(const clock_tree *clocks);

/* What was sampled at the beginning of `tick`; `sense` is written only with PLANT_READY. WAITING: ask again.
 */
plant_answer plant_sense(uint32_t tick, wheel_sense *sense);

/* True while there is something new for plant_sense to look at. */
bool plant_has_received(void);

/* The set points that hold during drive->tick. */
void plant_drive(const wheel_drive *drive);

/* Drives off, whatever else is broken; also before plant_open. */
void plant_off(void);

#endif
