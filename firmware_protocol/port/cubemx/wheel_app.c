#include "wheel_app.h"

#include "main.h"
#include "node.h"

static const wheel_parameters built_in = {
    .counts_per_revolution = 4096.0f,
    .wheel_radius_m = 0.075f,
    .half_length_m = 0.3f,
    .half_width_m = 0.3f,
    .tracking_bandwidth_rad_s = 150.0f,
    .speed_kp_n_m_s_rad = 1.1f,
    .speed_ki_n_m_rad = 25.0f,
    .torque_limit_n_m = 5.0f,
    .torque_constant_n_m_a = 1.25f,
    .motor_resistance_ohm = 0.6f,
    .motor_inductance_h = 0.0005f,
    .current_limit_a = 12.0f,
    .current_bandwidth_rad_s = 1000.0f,
    .temperature_limit_degc = 90.0f,
    .undervoltage_v = 19.0f,
    .overspeed_rad_s = 40.0f,
    .encoder_fault_s = 0.1f,
    .watchdog_s = 0.05f,
    .ramp_s = 0.2f,
    .feedback_period_s = 0.005f,
};

/* No STORAGE: STORE is refused, and the parameters are those above after each reset. No LOCKSTEP, never. */
static const wheel_identity identity = {
    .capabilities = WHEEL_CAPABILITY_POWER_STAGE | WHEEL_CAPABILITY_SPEED | WHEEL_CAPABILITY_TORQUE |
                    WHEEL_CAPABILITY_FEEDFORWARD | WHEEL_CAPABILITY_CURRENTS | WHEEL_CAPABILITY_POWER,
    .board = 100, /* of your own; STATUS tells no cause of a reset, as .reset_cause is UNKNOWN */
    .version = {1, 0, 0},
};

static TIM_HandleTypeDef *const encoders[WHEEL_COUNT] = {&htim2, &htim3, &htim4, &htim5};
static const uint32_t channels[WHEEL_COUNT] = {TIM_CHANNEL_1, TIM_CHANNEL_2, TIM_CHANNEL_3, TIM_CHANNEL_4};

static wheel_node node;
static wheel_deframer deframer;
static uint8_t sequence;

static uint8_t received[512];          /* filled by the DMA, round and round */
static volatile uint16_t received_end; /* how far */
static uint16_t received_begin;        /* how far it was read */
static volatile bool has_broken_off;   /* the HAL has stopped receiving */
static uint8_t sending[WHEEL_FRAME_MAX * 16u];
static uint16_t samples[WHEEL_COUNT + 1u]; /* currents and battery, by the DMA */

static volatile uint32_t ticks_due;
static uint32_t ticks_run;

/* ---- what the HAL calls, in interrupts ---- */

void HAL_UARTEx_RxEventCallback(UART_HandleTypeDef *uart, uint16_t position) {
    if (uart == &huart2) {
        received_end = (uint16_t)(position % sizeof received);
    }
}

void HAL_UART_ErrorCallback(UART_HandleTypeDef *uart) {
    if (uart == &huart2) {
        has_broken_off = true;
    }
}

void HAL_TIM_PeriodElapsedCallback(TIM_HandleTypeDef *timer) {
    if (timer == &htim6) {
        ticks_due++;
    }
}

/* ---- the robot ---- */

void wheel_app_motors_off(void) {
    __HAL_TIM_MOE_DISABLE_UNCONDITIONALLY(&htim8);
    HAL_GPIO_WritePin(BRIDGES_ENABLE_GPIO_Port, BRIDGES_ENABLE_Pin, GPIO_PIN_RESET);
}

static void set_direction(size_t wheel, GPIO_PinState forward) {
    switch (wheel) {
    case 0:
        HAL_GPIO_WritePin(DIRECTION_FL_GPIO_Port, DIRECTION_FL_Pin, forward);
        break;
    case 1:
        HAL_GPIO_WritePin(DIRECTION_FR_GPIO_Port, DIRECTION_FR_Pin, forward);
        break;
    case 2:
        HAL_GPIO_WritePin(DIRECTION_RR_GPIO_Port, DIRECTION_RR_Pin, forward);
        break;
    default:
        HAL_GPIO_WritePin(DIRECTION_RL_GPIO_Port, DIRECTION_RL_Pin, forward);
        break;
    }
}

static void drive(const wheel_drive *set_points) {
    if (set_points->enabled == 0u) {
        wheel_app_motors_off();
        return;
    }
    const float period = (float)__HAL_TIM_GET_AUTORELOAD(&htim8);
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        const float duty = set_points->duty[i];
        set_direction(i, duty >= 0.0f ? GPIO_PIN_SET : GPIO_PIN_RESET);
        __HAL_TIM_SET_COMPARE(&htim8, channels[i], (uint32_t)(period * (duty < 0.0f ? -duty : duty)));
    }
    if ((htim8.Instance->BDTR & TIM_BDTR_MOE) == 0u) {
        HAL_TIM_GenerateEvent(&htim8, TIM_EVENTSOURCE_UPDATE); /* these duties from the first period on */
        __HAL_TIM_MOE_ENABLE(&htim8);
    }
    HAL_GPIO_WritePin(BRIDGES_ENABLE_GPIO_Port, BRIDGES_ENABLE_Pin, GPIO_PIN_SET);
}

static void sense(wheel_sense *values) {
    *values = (wheel_sense){.tick = node.tick};
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        values->count[i] = (uint16_t)__HAL_TIM_GET_COUNTER(encoders[i]);
        values->current_a[i] = ((float)samples[i] - 2048.0f) * 0.0183f;
    }
    values->battery_v = (float)samples[WHEEL_COUNT] * 0.00886f;
}

/* ---- the host's line ---- */

static uint32_t now_us(void) {
    return node.tick * 1000u; /* to the millisecond; a timer of 1 MHz would tell more */
}

static void take(uint8_t byte) {
    wheel_frame frame;
    if (wheel_deframer_feed(&deframer, byte, &frame)) {
        wheel_node_receive(&node, &frame, now_us());
    }
}

static void receive(void) {
    if (has_broken_off) { /* no callback comes until the DMA is started again */
        has_broken_off = false;
        node.transport.overrun++;
        take(0); /* ends the frame of which the rest is lost */
        received_end = 0;
        received_begin = 0;
        HAL_UARTEx_ReceiveToIdle_DMA(&huart2, received, sizeof received);
    }
    while (received_begin != received_end) {
        take(received[received_begin]);
        received_begin = (uint16_t)((received_begin + 1u) % sizeof received);
    }
    node.transport.cobs = deframer.cobs;
    node.transport.crc = deframer.crc;
    node.transport.length = deframer.length_errors;
    node.transport.unknown_id = deframer.unknown_id;
    node.transport.serial_lost = deframer.lost;
}

static void transmit(void) {
    wheel_frame frame;
    size_t used = 0;
    if (huart2.gState != HAL_UART_STATE_READY) {
        return; /* the last buffer is still on its way */
    }
    while (sizeof sending - used >= WHEEL_FRAME_MAX && wheel_node_transmit(&node, &frame, now_us())) {
        used += wheel_frame_encode(&frame, sequence++, sending + used);
    }
    if (used > 0u) {
        HAL_UART_Transmit_DMA(&huart2, sending, (uint16_t)used);
    }
}

/* ---- called by main ---- */

void wheel_app_start(void) {
    wheel_app_motors_off();
    wheel_deframer_init(&deframer);
    wheel_node_init(&node, &built_in, NULL, &identity);
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        HAL_TIM_Encoder_Start(encoders[i], TIM_CHANNEL_ALL);
        HAL_TIM_PWM_Start(&htim8, channels[i]);
    }
    wheel_app_motors_off(); /* HAL_TIM_PWM_Start has switched the outputs on */
    HAL_ADC_Start_DMA(&hadc1, (uint32_t *)(void *)samples, WHEEL_COUNT + 1u);
    HAL_UARTEx_ReceiveToIdle_DMA(&huart2, received, sizeof received);
    HAL_TIM_Base_Start_IT(&htim6);
}

void wheel_app_run(void) {
    receive();
    while (ticks_run != ticks_due) { /* late ticks are made up: the age of a command counts in them */
        wheel_sense values;
        wheel_drive set_points;
        ticks_run++;
        sense(&values);
        wheel_node_sense(&node, &values);
        wheel_node_drive(&node, &set_points);
        drive(&set_points);
        HAL_IWDG_Refresh(&hiwdg); /* here only: what does not tick is reset */
    }
    transmit();
}
