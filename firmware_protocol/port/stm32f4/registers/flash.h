/* Flash interface (RM0090, section 3.9). */
#ifndef STM32F4_REGISTERS_FLASH_H
#define STM32F4_REGISTERS_FLASH_H

#include <stdint.h>

typedef struct {
    volatile uint32_t ACR;     /* 00 */
    volatile uint32_t KEYR;    /* 04 */
    volatile uint32_t OPTKEYR; /* 08 */
    volatile uint32_t SR;      /* 0C */
    volatile uint32_t CR;      /* 10 */
} flash_registers;

#define FLASH ((flash_registers *)0x40023C00u)

#define FLASH_ACR_LATENCY(wait_states) ((uint32_t)(wait_states))
#define FLASH_ACR_LATENCY_MASK 7u
#define FLASH_ACR_PRFTEN (1u << 8)
#define FLASH_ACR_ICEN (1u << 9)
#define FLASH_ACR_DCEN (1u << 10)
#define FLASH_ACR_DCRST (1u << 12)
#define FLASH_KEY1 0x45670123u
#define FLASH_KEY2 0xCDEF89ABu
#define FLASH_SR_ERRORS 0x000000F2u /* OPERR, WRPERR, PGAERR, PGPERR, PGSERR; cleared by writing 1 */
#define FLASH_SR_BSY (1u << 16)
#define FLASH_CR_PG (1u << 0)
#define FLASH_CR_SER (1u << 1)
#define FLASH_CR_SNB(sector) ((uint32_t)(sector) << 3)
#define FLASH_CR_PSIZE_32 (2u << 8) /* 32 bits at a time, for supplies from 2.7 V on */
#define FLASH_CR_STRT (1u << 16)
#define FLASH_CR_LOCK (1u << 31)

#endif
