/* The firmware core on this chip: between the line to the host, the body and the clock. */
#ifndef STM32F4_ROBOT_H
#define STM32F4_ROBOT_H

#include <stdbool.h>
#include <stdint.h>

#include "../../firmware/node.h"
#include "clock.h"

typedef struct {
    wheel_node node;
    clock_tree clocks;
    wheel_sense sense;
    uint32_t seen_ms;       /* uptime when the loop last woke */
    uint32_t ran_ms;        /* and that of the last tick in real time */
    uint32_t tick_began_us; /* uptime at the beginning of the tick */
    uint32_t tick_us;       /* robot time then */
} robot;

/* Starts everything, up to the first sampled values. */
void robot_start(robot *r);

/* Takes what the host sent, and answers. */
void robot_serve(robot *r);

/* In real time: runs the tick that is due. Late ticks are not made up; robot time is late then. */
void robot_tick(robot *r);

/* Sleeps until there may be something to do; the other one, until the body may have answered. */
void robot_idle(robot *r);
void robot_await_plant(robot *r);

/* The two halves of a tick. robot_sense is false while the body has not answered: call it again. */
bool robot_sense(robot *r);
void robot_drive(robot *r);

/* Sends what the node has to say: in real time as far as the line takes it, in lockstep all of it. */
void robot_transmit(robot *r);

#endif
