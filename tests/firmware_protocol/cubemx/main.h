/* Stands in for what CubeMX generates and for the part of ST's HAL that CUBEMX.md uses, with the HAL's names
 * and types; hal.c remembers what is called. */
#ifndef MAIN_H
#define MAIN_H

#include <stdint.h>

typedef enum { HAL_OK = 0 } HAL_StatusTypeDef;
typedef enum { HAL_UART_STATE_READY = 0x20, HAL_UART_STATE_BUSY_TX = 0x21 } HAL_UART_StateTypeDef;
typedef enum { GPIO_PIN_RESET = 0, GPIO_PIN_SET } GPIO_PinState;

typedef struct {
    uint32_t ODR;
} GPIO_TypeDef;

typedef struct {
    uint32_t CNT, ARR, CCR[4], BDTR;
    uint32_t in_force[4]; /* CCR as of the last update, not a register */
} TIM_TypeDef;

typedef struct {
    TIM_TypeDef *Instance;
} TIM_HandleTypeDef;

typedef struct {
    volatile HAL_UART_StateTypeDef gState;
} UART_HandleTypeDef;

typedef struct {
    uint32_t unused;
} ADC_HandleTypeDef;

typedef struct {
    uint32_t refreshed;
} IWDG_HandleTypeDef;

extern UART_HandleTypeDef huart2;
extern TIM_HandleTypeDef htim2, htim3, htim4, htim5, htim6, htim8;
extern ADC_HandleTypeDef hadc1;
extern IWDG_HandleTypeDef hiwdg;
extern GPIO_TypeDef gpio;

#define BRIDGES_ENABLE_GPIO_Port (&gpio)
#define BRIDGES_ENABLE_Pin ((uint16_t)0x0001)
#define DIRECTION_FL_GPIO_Port (&gpio)
#define DIRECTION_FL_Pin ((uint16_t)0x0002)
#define DIRECTION_FR_GPIO_Port (&gpio)
#define DIRECTION_FR_Pin ((uint16_t)0x0004)
#define DIRECTION_RR_GPIO_Port (&gpio)
#define DIRECTION_RR_Pin ((uint16_t)0x0008)
#define DIRECTION_RL_GPIO_Port (&gpio)
#define DIRECTION_RL_Pin ((uint16_t)0x0010)

#define TIM_CHANNEL_1 0x00000000U
#define TIM_CHANNEL_2 0x00000004U
#define TIM_CHANNEL_3 0x00000008U
#define TIM_CHANNEL_4 0x0000000CU
#define TIM_CHANNEL_ALL 0x0000003CU
#define TIM_BDTR_MOE 0x00008000U
#define TIM_EVENTSOURCE_UPDATE 0x00000001U
#define __HAL_TIM_GET_COUNTER(handle) ((handle)->Instance->CNT)
#define __HAL_TIM_GET_AUTORELOAD(handle) ((handle)->Instance->ARR)
#define __HAL_TIM_SET_COMPARE(handle, channel, value) ((handle)->Instance->CCR[(channel) / 4U] = (value))
#define __HAL_TIM_MOE_ENABLE(handle) ((handle)->Instance->BDTR |= TIM_BDTR_MOE)
#define __HAL_TIM_MOE_DISABLE_UNCONDITIONALLY(handle) ((handle)->Instance->BDTR &= ~TIM_BDTR_MOE)

HAL_StatusTypeDef HAL_Init(void);
void HAL_GPIO_WritePin(GPIO_TypeDef *port, uint16_t pin, GPIO_PinState state);
HAL_StatusTypeDef HAL_TIM_Base_Start_IT(TIM_HandleTypeDef *timer);
HAL_StatusTypeDef HAL_TIM_Encoder_Start(TIM_HandleTypeDef *timer, uint32_t channel);
HAL_StatusTypeDef HAL_TIM_PWM_Start(TIM_HandleTypeDef *timer, uint32_t channel);
HAL_StatusTypeDef HAL_TIM_GenerateEvent(TIM_HandleTypeDef *timer, uint32_t source);
HAL_StatusTypeDef HAL_ADC_Start_DMA(ADC_HandleTypeDef *adc, uint32_t *data, uint32_t length);
HAL_StatusTypeDef HAL_UART_Transmit_DMA(UART_HandleTypeDef *uart, const uint8_t *data, uint16_t size);
HAL_StatusTypeDef HAL_UARTEx_ReceiveToIdle_DMA(UART_HandleTypeDef *uart, uint8_t *data, uint16_t size);
HAL_StatusTypeDef HAL_IWDG_Refresh(IWDG_HandleTypeDef *watchdog);
void HAL_UARTEx_RxEventCallback(UART_HandleTypeDef *uart, uint16_t position);
void HAL_UART_ErrorCallback(UART_HandleTypeDef *uart);
void HAL_TIM_PeriodElapsedCallback(TIM_HandleTypeDef *timer);

void SystemClock_Config(void);
void MX_GPIO_Init(void);
void MX_DMA_Init(void);
void MX_USART2_UART_Init(void);
void MX_TIM2_Init(void);
void MX_TIM3_Init(void);
void MX_TIM4_Init(void);
void MX_TIM5_Init(void);
void MX_TIM6_Init(void);
void MX_TIM8_Init(void);
void MX_ADC1_Init(void);
void MX_IWDG_Init(void);

#endif
