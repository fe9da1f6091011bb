/* Hardware in the loop: the body is simulated at the other end of a second serial line. No motor exists here,
 * and no file that knows a motor's pins is linked.
 */
#include "plant.h"

#include "board.h"
#include "plant_codec.h"
#include "uptime.h"
#include "usart.h"

/* An answer that takes longer than this is asked for again; an emulator's own milliseconds are short. */
#define RETRY_MS 10u
#define RETRY_EMULATED_MS 100u
/* And this is the end: the robot faults. From then on it only asks whether somebody is there again. */
#define LOST_MS 2000u

static struct {
    usart line;
    plant_deframer deframer;
    uint8_t sequence;
    uint8_t request[PLANT_FRAME_MAX]; /* the last one sent */
    size_t request_length;
    uint32_t awaited_tick; /* of the answer */
    uint32_t retry_ms;
    uint32_t asked_ms;
    uint32_t sent_ms;
    bool lost;
} plant;

static void send(void) {
    if (usart_room(&plant.line) >= plant.request_length) {
        usart_send(&plant.line, plant.request, plant.request_length);
    }
    plant.sent_ms = uptime_ms();
}

static void ask(size_t request_length, uint32_t awaited_tick) {
    plant.request_length = request_length;
    plant.awaited_tick = awaited_tick;
    plant.asked_ms = uptime_ms();
    send();
}

static void ask_for_sample(uint32_t tick) {
    ask(plant_encode_sample(tick, plant.sequence++, plant.request), tick);
}

uint16_t plant_capabilities(void) {
    return WHEEL_CAPABILITY_SPEED | WHEEL_CAPABILITY_TORQUE | WHEEL_CAPABILITY_FEEDFORWARD |
           WHEEL_CAPABILITY_CURRENTS | WHEEL_CAPABILITY_GYRO | WHEEL_CAPABILITY_ACCELEROMETER |
           WHEEL_CAPABILITY_POWER | WHEEL_CAPABILITY_TEMPERATURES;
}

void plant_open(const clock_tree *clocks) {
    usart_open(&plant.line, &PLANT_LINE, clocks);
    plant.retry_ms = clocks->lockstep ? RETRY_EMULATED_MS : RETRY_MS;
    ask_for_sample(0);
}

static bool receive(wheel_sense *sense) {
    wheel_sense heard;
    uint8_t byte;
    bool answered = false;
    while (!answered && usart_receive(&plant.line, &byte)) {
        answered = plant_deframer_feed(&plant.deframer, byte, &heard) && heard.tick == plant.awaited_tick;
    }
    if (answered) {
        *sense = heard;
    }
    return answered;
}

plant_answer plant_sense(uint32_t tick, wheel_sense *sense) {
    if (receive(sense)) {
        sense->tick = tick; /* it may have come back for a tick that is over */
        plant.lost = false;
        return PLANT_READY;
    }
    const uint32_t now_ms = uptime_ms();
    plant.lost = plant.lost || now_ms - plant.asked_ms >= LOST_MS;
    if (now_ms - plant.sent_ms >= plant.retry_ms) {
        if (plant.lost) {
            ask_for_sample(tick);
        } else {
            send();
        }
    }
    return plant.lost ? PLANT_FAILED : PLANT_WAITING;
}

bool plant_has_received(void) {
    return usart_has_received(&plant.line);
}

void plant_drive(const wheel_drive *drive) {
    if (!plant.lost) {
        ask(plant_encode_drive(drive, plant.sequence++, plant.request), drive->tick + 1u);
    }
}

void plant_off(void) {
    /* The line falls silent, and time stands still in the plant. */
}
