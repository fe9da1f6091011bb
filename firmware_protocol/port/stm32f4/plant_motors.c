/* The body is a real robot: four motors with encoders and current sensors. */
#include <string.h>

#include "analog.h"
#include "encoders.h"
#include "motor_board.h"
#include "plant.h"
#include "pwm.h"

static struct {
    bool sensors_good;
    float duty[WHEEL_COUNT]; /* in force */
} body;

uint16_t plant_capabilities(void) {
    const uint16_t temperatures = MOTORS.has_temperatures ? WHEEL_CAPABILITY_TEMPERATURES : 0u;
    return WHEEL_CAPABILITY_POWER_STAGE | WHEEL_CAPABILITY_SPEED | WHEEL_CAPABILITY_TORQUE |
           WHEEL_CAPABILITY_FEEDFORWARD | WHEEL_CAPABILITY_CURRENTS | WHEEL_CAPABILITY_POWER | temperatures;
}

void plant_open(const clock_tree *clocks) {
    pwm_open(clocks);
    encoders_open();
    analog_open();
    body.sensors_good = analog_calibrate();
}

plant_answer plant_sense(uint32_t tick, wheel_sense *sense) {
    if (!body.sensors_good || !analog_is_good() || pwm_has_broken()) {
        return PLANT_FAILED;
    }
    memset(sense, 0, sizeof *sense);
    sense->tick = tick;
    encoders_read(sense->count);
    analog_currents(sense->current_a);
    analog_temperatures(sense->temperature_degc);
    sense->battery_v = analog_battery_v();
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        /* The power that goes into a bridge without losses comes out of it. */
        sense->battery_a += body.duty[i] * sense->current_a[i];
    }
    return PLANT_READY;
}

bool plant_has_received(void) {
    return false; /* the tick is what there is to wait for */
}

void plant_drive(const wheel_drive *drive) {
    if (drive->enabled == 0u) {
        plant_off();
        memset(body.duty, 0, sizeof body.duty);
        return;
    }
    memcpy(body.duty, drive->duty, sizeof body.duty);
    pwm_drive(body.duty);
}

void plant_off(void) {
    pwm_off();
}
