/* The line to the host: frames in, frames out. A build links host_serial.c or host_can.c. */
#ifndef STM32F4_HOST_LINK_H
#define STM32F4_HOST_LINK_H

#include <stdbool.h>

#include "../../firmware/node.h"
#include "clock.h"

void host_link_open(const clock_tree *clocks);

/* Takes the next valid frame; false when there is none. */
bool host_link_receive(wheel_frame *frame);

/* True while there is something for host_link_receive to look at. */
bool host_link_has_received(void);

/* Sends a frame for which there is room. */
bool host_link_has_room(void);
void host_link_send(const wheel_frame *frame);

/* True once after the link went down by itself: what was armed through it has to stop. */
bool host_link_went_down(void);

void host_link_counters(wheel_transport_counters *counters);

#endif
