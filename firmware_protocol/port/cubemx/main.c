#include "main.h"
#include "wheel_app.h"

int main(void) {
    HAL_Init();
    SystemClock_Config();
    MX_GPIO_Init();
    MX_DMA_Init();
    MX_USART2_UART_Init();
    MX_TIM2_Init();
    MX_TIM3_Init();
    MX_TIM4_Init();
    MX_TIM5_Init();
    MX_TIM6_Init();
    MX_TIM8_Init();
    MX_ADC1_Init();
    MX_IWDG_Init();
    /* USER CODE BEGIN 2 */
    wheel_app_start();
    /* USER CODE END 2 */
    while (1) {
        /* USER CODE BEGIN 3 */
        wheel_app_run();
    }
    /* USER CODE END 3 */
}
