/* Analog-to-digital converter 1 (RM0090, sections 13.13), and the DMA stream that serves it (10.5). */
#ifndef STM32F4_REGISTERS_ADC_H
#define STM32F4_REGISTERS_ADC_H

#include <stdint.h>

typedef struct {
    volatile uint32_t SR;  /* 00 */
    volatile uint32_t CR1; /* 04 */
    volatile uint32_t CR2; /* 08 */
    volatile uint32_t SMPR1;
    volatile uint32_t SMPR2;
    volatile uint32_t JOFR[4];
    volatile uint32_t HTR;
    volatile uint32_t LTR;
    volatile uint32_t SQR[3]; /* 2C: SQR1, SQR2, SQR3 */
    volatile uint32_t JSQR;
    volatile uint32_t JDR[4];
    volatile uint32_t DR; /* 4C */
} adc_registers;

_Static_assert(sizeof(adc_registers) == 0x50u, "the registers lie where the manual has them");

typedef struct {
    volatile uint32_t CR;
    volatile uint32_t NDTR;
    volatile uint32_t PAR;
    volatile uint32_t M0AR;
} dma_stream;

#define ADC1 ((adc_registers *)0x40012000u)
#define ADC_COMMON_CCR (*(volatile uint32_t *)0x40012304u)
#define DMA2_STREAM0 ((dma_stream *)0x40026410u)

#define ADC_CCR_DIV4 (1u << 16)
#define ADC_SR_OVR (1u << 5) /* a conversion was lost */
#define ADC_CR1_SCAN (1u << 8)
#define ADC_CR2_ADON (1u << 0)
#define ADC_CR2_CONT (1u << 1)
#define ADC_CR2_DMA (1u << 8)
#define ADC_CR2_DDS (1u << 9) /* DMA requests go on after the last transfer of a round */
#define ADC_CR2_SWSTART (1u << 30)
#define ADC_SMPR_56_CYCLES 3u
#define DMA_CR_EN (1u << 0)
#define DMA_CR_CIRC (1u << 8)
#define DMA_CR_MINC (1u << 10)
#define DMA_CR_16_BITS ((1u << 11) | (1u << 13))

#endif
