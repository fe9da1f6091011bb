/* What the vector table points at. Interrupts that a build does not use end in fault(). All have the same
 * priority: none interrupts another, and each is short.
 */
#ifndef STM32F4_INTERRUPTS_H
#define STM32F4_INTERRUPTS_H

void systick_interrupt(void);
void usart1_interrupt(void);
void usart2_interrupt(void);
void usart3_interrupt(void);
void uart4_interrupt(void);
void uart5_interrupt(void);
void usart6_interrupt(void);
void can1_transmit_interrupt(void);
void can1_receive_interrupt(void);
void can1_status_interrupt(void);

/* Switches the drives off, leaves a record and resets the chip: fault.c. */
void fault(void);

#endif
