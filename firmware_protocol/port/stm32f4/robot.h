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
    uint32_t due_ms;        /* and that at which the next tick is due in real time */
    uint32_t ticks_late;    /* that ended after the next one was due, for a debugger */
    uint32_t ticks_lost;    /* and those that were not made up */
    uint32_t tick_began_us; /* uptime at the beginning of the tick */
    uint32_t tick_us;       /* robot time then */
} robot;

/* Starts everything, up to the first sampled values. */
void robot_start(robot *r);

/* Takes what the host sent, and answers. */
void robot_serve(robot *r);

/* In real time: runs the ticks that are due, so that late ones are made up and what counts in ticks, such as
 * the age of a command, stays true. */
void robot_tick(robot *r);

/* Sleeps until there may be something to do; the other one, until the body may have answered or, in real
 * time, the host has said something. */
void robot_idle(robot *r);
void robot_await_plant(robot *r);

/* The two halves of a tick. robot_sense is false while the body has not answered: call it again. */
bool robot_sense(robot *r);
void robot_drive(robot *r);

/* Sends what the node has to say: in real time as far as the line takes it, in lockstep all of it. */
void robot_transmit(robot *r);

#endif
