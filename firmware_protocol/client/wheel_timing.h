/* How old the newest feedback of a robot is, and how late commands act: what a control loop must know to
 * drive. For every robot, ours or another maker's; no I/O, allocation or static data. Times are [ns]: the
 * robot's by its own clock, all others by the host's.
 */
#ifndef WHEEL_TIMING_H
#define WHEEL_TIMING_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* cffi: begin */
/* Whether feedback, and a truth that the state estimate uses, are fresh enough to drive by. Begin with zeros,
 * and `stale_ns`, the greatest age at which the robot is still driven. The rest is only to be read. */
typedef struct {
    int64_t stale_ns;
    int64_t silent_ns; /* since new feedback last came */
    int64_t newest_ns; /* the robot's time of the newest feedback */
    int64_t received_ns;
    int64_t truth_ns; /* the robot's time of the newest truth, if has_truth */
    int64_t truth_received_ns;
    int64_t truth_stamp_ns; /* by the truth's own clock */
    int64_t ahead_ns;       /* the robot's clock minus the truth's */
    bool has_received;
    bool has_truth;
    bool has_stamp;
    bool is_apart; /* `ahead_ns` is not known, because the robot's clock began anew */
    bool is_stale; /* whether feedback or truth is too old to drive by */
} wheel_freshness;

#define WHEEL_FRESHNESS_GOOD 0
#define WHEEL_FRESHNESS_RESET 1  /* a robot that is not driven began its clock anew */
#define WHEEL_FRESHNESS_STATE 2  /* it is driven, and not ACTIVE */
#define WHEEL_FRESHNESS_UNREAD 3 /* feedback lay unread for too long: this process stood still */
#define WHEEL_FRESHNESS_SILENT 4 /* no feedback for so long that the link or the robot was lost */

/* Adds the newest feedback, once a tick. `age_ns` is how long it may have lain in the link: after a stall of
 * this process it does not count as new, and the robot's clock is not judged by it. `is_driven`: the robot
 * has to be ACTIVE. `truth_ns` is the time of a truth by its own clock, NULL without one. It is that of the
 * plant, which a reset of the robot does not change: the first after one, or after the truth's own clock
 * jumped back, is taken to be as old as the feedback. If the result is not GOOD, the truth is not added. */
uint8_t wheel_freshness_add(wheel_freshness *freshness, int64_t robot_ns, uint8_t state, int64_t age_ns,
                            int64_t now_ns, bool is_driven, const int64_t *truth_ns);

/* Begins again with a robot that came back. `was_reset`: its clock began anew. */
void wheel_freshness_restart(wheel_freshness *freshness, bool was_reset);

#define WHEEL_LATENCY_COMMANDS 33 /* of which the median is taken */

/* The latency of commands: from the sampling instant behind a command to the first firmware tick that uses
 * it, both by the robot's clock, so that clocks need not be compared. Feedback reports which command is in
 * force, and how old it is to 1 ms. */
typedef struct {
    int64_t longest_ns;      /* those that are longer, or negative, are ignored */
    double median_s;         /* of the last 33, so that single delayed commands do not matter; as it was set
                                before 9 were seen */
    int64_t sampled_ns[256]; /* by sequence number */
    bool is_sent[256];
    int64_t recent_ns[WHEEL_LATENCY_COMMANDS];
    int64_t sorted_ns[WHEEL_LATENCY_COMMANDS]; /* the same */
    uint32_t count;                            /* of all that were seen */
} wheel_latency;

void wheel_latency_init(wheel_latency *latency, double configured_s, int64_t longest_ns);

/* Adds feedback of the robot's time `robot_ns`: this command was in force, and so old [ms]. */
void wheel_latency_acted(wheel_latency *latency, uint8_t sequence, int64_t robot_ns, uint8_t age_ms);

/* Adds a command, and the robot's time at which what it is based on was sampled. */
void wheel_latency_sent(wheel_latency *latency, uint8_t sequence, int64_t sampled_ns);

/* Begins a new session, in which the robot's clock may begin anew; `median_s` stays. */
void wheel_latency_restart(wheel_latency *latency);
/* cffi: end */

#ifdef __cplusplus
}
#endif

#endif
