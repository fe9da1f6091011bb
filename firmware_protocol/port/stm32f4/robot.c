#include "robot.h"

#include "board.h"
#include "host_link.h"
#include "lockstep.h"
#include "parameter_log.h"
#include "plant.h"
#include "registers/core.h"
#include "reset_cause.h"
#include "supply.h"
#include "uptime.h"
#include "watchdog.h"

/* At the start, and where a STORE has to erase: a sector of 128 KB takes up to 2 s (data sheet, table 40),
 * and nothing feeds meanwhile. */
#define START_LIMIT_MS 4000u
/* Some ticks, and the 2 ms in which a STORE writes the flash. */
#define RUN_LIMIT_MS 30u
/* With motors the watchdog lets no more pass; only a simulated body may be later, and then the robot is too.
 */
#define MADE_UP_MS 64u

void robot_start(robot *r) {
    plant_off();
    watchdog_set(START_LIMIT_MS);
    supply_open();
    r->clocks = clock_init();
    uptime_start(r->clocks.core_hz);
    const uint16_t lockstep = r->clocks.lockstep ? WHEEL_CAPABILITY_LOCKSTEP : 0u;
    wheel_identity identity = {
        .capabilities = (uint16_t)(plant_capabilities() | WHEEL_CAPABILITY_STORAGE | lockstep),
        .board = BOARD.number,
        .version = {0, 1, 0},
        .build = FIRMWARE_BUILD,
        .maximum = BOARD.maximum,
    };
    identity.reset_cause = reset_cause_take(&r->clocks, &identity.processor_fault);
    wheel_node_init(&r->node, &BOARD.parameters, parameter_log_open(), &identity);
    host_link_open(&r->clocks);
    plant_open(&r->clocks);
    watchdog_set(RUN_LIMIT_MS);
    while (!robot_sense(r)) {
        if (!r->clocks.lockstep) {
            robot_serve(r); /* a host asks who is there while nobody plays the plant yet */
        }
        robot_await_plant(r);
    }
    robot_transmit(r);
    if (!r->clocks.lockstep) {
        robot_drive(r);
        r->due_ms = uptime_ms() + 1u;
    }
}

/* The robot's clock, that of TICK.time_us. In lockstep it stands still between ticks; in real time it runs on
 * from the tick's beginning, but not past the next one's. */
static uint32_t now_us(const robot *r) {
    if (r->clocks.lockstep) {
        return r->node.tick * 1000u;
    }
    const uint32_t since_us = uptime_us() - r->tick_began_us;
    return r->tick_us + (since_us < 999u ? since_us : 999u);
}

static bool store(robot *r) {
    uint8_t bytes[WHEEL_STORED_SIZE];
    const bool is_pending = wheel_node_store_pending(&r->node, bytes);
    if (is_pending) {
        const bool erases = parameter_log_is_full();
        if (erases) {
            watchdog_set(START_LIMIT_MS);
        }
        wheel_node_stored(&r->node, parameter_log_append(bytes));
        if (erases) {
            watchdog_set(RUN_LIMIT_MS);
        }
    }
    return is_pending;
}

void robot_serve(robot *r) {
    wheel_frame frame;
    if (host_link_went_down()) {
        /* The bus is back after 128 times 11 bits, before the silence would have been noticed. */
        wheel_node_stop(&r->node, WHEEL_EVENT_TIMEOUT, WP_STOP_REASON_COMMAND_TIMEOUT);
    }
    bool has_stored = false; /* takes milliseconds: the ticks that became due come before the next frame */
    while (!has_stored && host_link_receive(&frame)) {
        host_link_counters(&r->node.transport);
        wheel_node_receive(&r->node, &frame, now_us(r));
        has_stored = store(r);
        robot_transmit(r);
        if (r->clocks.lockstep && lockstep_serve != NULL) {
            lockstep_serve(r);
        }
    }
    host_link_counters(&r->node.transport);
    robot_transmit(r);
}

bool robot_sense(robot *r) {
    const plant_answer answer = plant_sense(r->node.tick, &r->sense);
    if (answer == PLANT_WAITING) {
        return false;
    }
    if (answer == PLANT_FAILED) {
        wheel_node_fail(&r->node); /* at every tick: a body that is gone is not cleared */
    }
    r->tick_began_us = uptime_us();
    r->tick_us = r->node.tick * 1000u;
    wheel_node_sense(&r->node, &r->sense);
    return true;
}

void robot_drive(robot *r) {
    wheel_drive drive;
    wheel_node_drive(&r->node, &drive);
    plant_drive(&drive);
    watchdog_feed();
}

void robot_transmit(robot *r) {
    wheel_frame frame;
    for (;;) {
        while (!host_link_has_room()) {
            if (!r->clocks.lockstep) {
                return;
            }
            watchdog_feed(); /* time stands still until a host listens: on CAN, until one acknowledges */
            robot_idle(r);
        }
        if (!wheel_node_transmit(&r->node, &frame, now_us(r))) {
            return;
        }
        host_link_send(&frame);
    }
}

static bool is_due(const robot *r) {
    return r->clocks.lockstep || (int32_t)(uptime_ms() - r->due_ms) >= 0;
}

void robot_tick(robot *r) {
    if (r->clocks.lockstep) {
        watchdog_feed(); /* time stands still until a host asks for more */
        return;
    }
    const uint32_t late_ms = uptime_ms() - r->due_ms;
    if ((int32_t)late_ms > (int32_t)MADE_UP_MS) {
        r->due_ms += late_ms;
        r->ticks_lost += late_ms;
    }
    while (is_due(r)) {
        if (!robot_sense(r)) {
            watchdog_feed(); /* the simulated body is late; plant_sense sets the limit */
            return;
        }
        robot_drive(r);
        r->ticks_late += uptime_ms() != r->due_ms ? 1u : 0u;
        r->due_ms++;
    }
}

/* Looks and sleeps with interrupts off, so that none comes in between; wfi wakes all the same. */
static void sleep_until_work(robot *r, bool host_too) {
    interrupts_off();
    const bool is_work = (is_due(r) && plant_has_received()) || (host_too && host_link_has_received());
    if (!is_work && uptime_ms() == r->seen_ms) {
        wait_for_interrupt();
    }
    interrupts_on();
    r->seen_ms = uptime_ms();
}

void robot_idle(robot *r) {
    sleep_until_work(r, true);
}

void robot_await_plant(robot *r) {
    watchdog_feed();
    sleep_until_work(r, !r->clocks.lockstep);
}
