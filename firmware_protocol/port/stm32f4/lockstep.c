#include "lockstep.h"

void lockstep_serve(robot *r) {
    uint32_t ticks;
    if (!wheel_node_step_pending(&r->node, &ticks)) {
        return;
    }
    for (uint32_t i = 0; i < ticks; i++) {
        robot_drive(r);
        while (!robot_sense(r)) {
            robot_await_plant(r);
        }
        robot_transmit(r);
    }
    wheel_node_step_done(&r->node);
    robot_transmit(r);
}
