/* What the HAL would do, on this machine: DMA into memory, registers that remember. */
#include <string.h>

#include "main.h"

static TIM_TypeDef tim[7];
UART_HandleTypeDef huart2 = {.gState = HAL_UART_STATE_READY};
TIM_HandleTypeDef htim2 = {&tim[0]}, htim3 = {&tim[1]}, htim4 = {&tim[2]}, htim5 = {&tim[3]},
                  htim6 = {&tim[4]}, htim8 = {&tim[5]};
ADC_HandleTypeDef hadc1;
IWDG_HandleTypeDef hiwdg;
GPIO_TypeDef gpio;

static uint8_t *receiving;
static uint16_t receiving_size, receiving_at;
static uint16_t *samples;
static uint8_t sent[65536];
static uint32_t sent_length;

void HAL_GPIO_WritePin(GPIO_TypeDef *port, uint16_t pin, GPIO_PinState state) {
    port->ODR = state == GPIO_PIN_SET ? port->ODR | pin : port->ODR & ~(uint32_t)pin;
}

HAL_StatusTypeDef HAL_TIM_Base_Start_IT(TIM_HandleTypeDef *timer) {
    (void)timer;
    return HAL_OK;
}

HAL_StatusTypeDef HAL_TIM_Encoder_Start(TIM_HandleTypeDef *timer, uint32_t channel) {
    (void)timer;
    (void)channel;
    return HAL_OK;
}

HAL_StatusTypeDef HAL_TIM_PWM_Start(TIM_HandleTypeDef *timer, uint32_t channel) {
    (void)channel;
    timer->Instance->ARR = 4200;
    __HAL_TIM_MOE_ENABLE(timer);
    return HAL_OK;
}

HAL_StatusTypeDef HAL_TIM_GenerateEvent(TIM_HandleTypeDef *timer, uint32_t source) {
    if (source == TIM_EVENTSOURCE_UPDATE) {
        memcpy(timer->Instance->in_force, timer->Instance->CCR, sizeof timer->Instance->CCR);
    }
    return HAL_OK;
}

HAL_StatusTypeDef HAL_ADC_Start_DMA(ADC_HandleTypeDef *adc, uint32_t *data, uint32_t length) {
    (void)adc;
    samples = (uint16_t *)(void *)data;
    for (uint32_t i = 0; i < length; i++) {
        samples[i] = i < 4u ? 2048u : 2709u; /* no current, 24 V */
    }
    return HAL_OK;
}

HAL_StatusTypeDef HAL_UART_Transmit_DMA(UART_HandleTypeDef *uart, const uint8_t *data, uint16_t size) {
    memcpy(sent + sent_length, data, size);
    sent_length += size;
    uart->gState = HAL_UART_STATE_BUSY_TX;
    return HAL_OK;
}

HAL_StatusTypeDef HAL_UARTEx_ReceiveToIdle_DMA(UART_HandleTypeDef *uart, uint8_t *data, uint16_t size) {
    (void)uart;
    receiving = data;
    receiving_size = size;
    receiving_at = 0;
    return HAL_OK;
}

HAL_StatusTypeDef HAL_IWDG_Refresh(IWDG_HandleTypeDef *watchdog) {
    watchdog->refreshed++;
    return HAL_OK;
}

/* cffi: begin */
void wheel_app_start(void);
void wheel_app_run(void);
void wheel_app_motors_off(void);
void bench_receive(const uint8_t *bytes, uint32_t length); /* arrives over the line */
void bench_overrun(void);                 /* the HAL reports one, and has stopped receiving */
uint32_t bench_take_sent(uint8_t *bytes); /* up to 65536 bytes */
void bench_millisecond(void);
uint32_t bench_outputs_on(void);
uint32_t bench_pins(void);
uint32_t bench_compare(uint32_t channel);
uint32_t bench_in_force(uint32_t channel);
uint32_t bench_refreshed(void);
/* cffi: end */

void bench_receive(const uint8_t *bytes, uint32_t length) {
    if (receiving == NULL) {
        return; /* lost, until the firmware starts again */
    }
    for (uint32_t i = 0; i < length; i++) {
        receiving[receiving_at++] = bytes[i];
        if (receiving_at == receiving_size) { /* the callback at the buffer's end */
            HAL_UARTEx_RxEventCallback(&huart2, receiving_at);
            receiving_at = 0;
        }
    }
    HAL_UARTEx_RxEventCallback(&huart2, receiving_at); /* and the one when the line falls idle */
}

void bench_overrun(void) {
    receiving = NULL;
    HAL_UART_ErrorCallback(&huart2);
}

uint32_t bench_take_sent(uint8_t *bytes) {
    const uint32_t length = sent_length;
    memcpy(bytes, sent, length);
    sent_length = 0;
    huart2.gState = HAL_UART_STATE_READY;
    return length;
}

void bench_millisecond(void) {
    HAL_TIM_GenerateEvent(&htim8, TIM_EVENTSOURCE_UPDATE); /* the timer's own: many in a millisecond */
    HAL_TIM_PeriodElapsedCallback(&htim6);
}

uint32_t bench_outputs_on(void) {
    return htim8.Instance->BDTR & TIM_BDTR_MOE;
}

uint32_t bench_pins(void) {
    return gpio.ODR;
}

uint32_t bench_compare(uint32_t channel) {
    return htim8.Instance->CCR[channel];
}

uint32_t bench_in_force(uint32_t channel) {
    return htim8.Instance->in_force[channel];
}

uint32_t bench_refreshed(void) {
    return hiwdg.refreshed;
}
