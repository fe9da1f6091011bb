/* USART (RM0090, section 30.6). */
#ifndef STM32F4_REGISTERS_USART_H
#define STM32F4_REGISTERS_USART_H

#include <stdint.h>

typedef struct {
    volatile uint32_t SR;  /* 00 */
    volatile uint32_t DR;  /* 04 */
    volatile uint32_t BRR; /* 08 */
    volatile uint32_t CR1; /* 0C */
    volatile uint32_t CR2; /* 10 */
    volatile uint32_t CR3; /* 14 */
} usart_registers;

#define USART1 ((usart_registers *)0x40011000u)
#define USART2 ((usart_registers *)0x40004400u)
#define USART3 ((usart_registers *)0x40004800u)
#define UART4 ((usart_registers *)0x40004C00u)
#define UART5 ((usart_registers *)0x40005000u)
#define USART6 ((usart_registers *)0x40011400u)

#define USART_SR_ORE (1u << 3)
#define USART_SR_RXNE (1u << 5)
#define USART_SR_TXE (1u << 7)
#define USART_CR1_RE (1u << 2)
#define USART_CR1_TE (1u << 3)
#define USART_CR1_RXNEIE (1u << 5)
#define USART_CR1_TXEIE (1u << 7)
#define USART_CR1_UE (1u << 13)

enum { USART1_IRQ = 37, USART2_IRQ = 38, USART3_IRQ = 39, UART4_IRQ = 52, UART5_IRQ = 53, USART6_IRQ = 71 };

#endif
