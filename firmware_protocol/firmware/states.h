/* The robot's states and what may follow what: a data table, the only place that decides it. */
#ifndef WHEEL_STATES_H
#define WHEEL_STATES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../generated/wheel_messages.h"

typedef enum {
    WHEEL_EVENT_READY,   /* the self test passed */
    WHEEL_EVENT_ARM,     /* an accepted ARM request */
    WHEEL_EVENT_COMMAND, /* the first accepted command, which is zero */
    WHEEL_EVENT_DISARM,  /* an IDLE request */
    WHEEL_EVENT_TIMEOUT, /* no fresh command in time */
    WHEEL_EVENT_STOPPED, /* set point at zero, and the wheels at rest or given up on */
    WHEEL_EVENT_ESTOP,
    WHEEL_EVENT_FAULT,
    WHEEL_EVENT_CLEAR /* an accepted CLEAR request */
} wheel_event;

typedef struct {
    uint8_t from;
    uint8_t event;
    uint8_t to;
} wheel_transition;

#define WHEEL_TRANSITION_COUNT 20
extern const wheel_transition wheel_transitions[WHEEL_TRANSITION_COUNT];

/* The state that follows, or the same state when the table does not know the event there. */
uint8_t wheel_next_state(uint8_t state, wheel_event event);

#endif
