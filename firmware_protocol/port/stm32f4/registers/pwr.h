/* Power control (RM0090, section 5.4), and the external interrupt line of its voltage detector (12.3). */
#ifndef STM32F4_REGISTERS_PWR_H
#define STM32F4_REGISTERS_PWR_H

#include <stdint.h>

typedef struct {
    volatile uint32_t CR;  /* 00 */
    volatile uint32_t CSR; /* 04 */
} pwr_registers;

typedef struct {
    volatile uint32_t IMR;  /* 00 */
    volatile uint32_t EMR;  /* 04 */
    volatile uint32_t RTSR; /* 08 */
    volatile uint32_t FTSR; /* 0C */
    volatile uint32_t SWIER;
    volatile uint32_t PR; /* 14, cleared by writing 1 */
} exti_registers;

#define PWR ((pwr_registers *)0x40007000u)
#define EXTI ((exti_registers *)0x40013C00u)

#define PWR_CR_PVDE (1u << 4)
#define PWR_CR_PLS_MASK (7u << 5)
#define PWR_CR_PLS_2V8 (6u << 5)
#define PWR_CSR_PVDO (1u << 2) /* the supply is below that level */
#define EXTI_PVD (1u << 16)

enum { PVD_IRQ = 1 };

#endif
