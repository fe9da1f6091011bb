/* bxCAN (RM0090, section 32.9). */
#ifndef STM32F4_REGISTERS_CAN_H
#define STM32F4_REGISTERS_CAN_H

#include <stdint.h>

typedef struct {
    volatile uint32_t IR;  /* identifier */
    volatile uint32_t DTR; /* length */
    volatile uint32_t DLR; /* bytes 0 to 3 */
    volatile uint32_t DHR; /* bytes 4 to 7 */
} can_mailbox;

typedef struct {
    volatile uint32_t MCR; /* 000 */
    volatile uint32_t MSR; /* 004 */
    volatile uint32_t TSR; /* 008 */
    volatile uint32_t RFR[2];
    volatile uint32_t IER; /* 014 */
    volatile uint32_t ESR; /* 018 */
    volatile uint32_t BTR; /* 01C */
    volatile uint32_t reserved_020[88];
    can_mailbox transmit[3]; /* 180 */
    can_mailbox receive[2];  /* 1B0 */
    volatile uint32_t reserved_1d0[12];
    volatile uint32_t FMR;  /* 200 */
    volatile uint32_t FM1R; /* 204, 1: list of identifiers */
    volatile uint32_t reserved_208;
    volatile uint32_t FS1R; /* 20C, 1: 32 bits wide */
    volatile uint32_t reserved_210;
    volatile uint32_t FFA1R; /* 214, 1: to FIFO 1 */
    volatile uint32_t reserved_218;
    volatile uint32_t FA1R; /* 21C, 1: active */
    volatile uint32_t reserved_220[8];
    volatile uint32_t FR[28][2]; /* 240 */
} can_registers;

_Static_assert(sizeof(can_registers) == 0x320u, "the registers lie where the manual has them");

#define CAN1 ((can_registers *)0x40006400u)

#define CAN_MCR_INRQ (1u << 0)
#define CAN_MCR_TXFP (1u << 2) /* mailboxes leave in the order of their requests */
#define CAN_MCR_ABOM (1u << 6) /* back from bus-off after 128 times 11 recessive bits */
#define CAN_MSR_INAK (1u << 0)
#define CAN_MSR_ERRI (1u << 2)
#define CAN_TSR_RQCP 0x00010101u                       /* requests completed; cleared by writing 1 */
#define CAN_TSR_ABRQ 0x00808080u                       /* abort all three */
#define CAN_TSR_TME(mailbox) (1u << (26u + (mailbox))) /* empty */
#define CAN_TSR_TME_ALL (7u << 26)
#define CAN_RFR_FMP 3u
#define CAN_RFR_FOVR (1u << 4)
#define CAN_RFR_RFOM (1u << 5)
#define CAN_IER_TMEIE (1u << 0)
#define CAN_IER_FMPIE0 (1u << 1)
#define CAN_IER_FOVIE0 (1u << 3)
#define CAN_IER_BOFIE (1u << 10)
#define CAN_IER_LECIE (1u << 11)
#define CAN_IER_ERRIE (1u << 15)
#define CAN_ESR_BOFF (1u << 2)
#define CAN_ESR_LEC (7u << 4)
#define CAN_BTR_BRP(x) ((uint32_t)(x) - 1u)
#define CAN_BTR_TS1(x) (((uint32_t)(x) - 1u) << 16)
#define CAN_BTR_TS2(x) (((uint32_t)(x) - 1u) << 20)
#define CAN_BTR_SJW(x) (((uint32_t)(x) - 1u) << 24)
#define CAN_IR_STID(id) ((uint32_t)(id) << 21)
#define CAN_IR_TXRQ (1u << 0)
#define CAN_FMR_FINIT (1u << 0)

enum { CAN1_TX_IRQ = 19, CAN1_RX0_IRQ = 20, CAN1_SCE_IRQ = 22 };

#endif
