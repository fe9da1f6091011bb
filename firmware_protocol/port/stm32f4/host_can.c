/* The host on CAN 1 (RM0090, chapter 32). Only the identifiers of the host's messages pass the filters. */
#include <string.h>

#include "board.h"
#include "host_link.h"
#include "interrupts.h"
#include "pins.h"
#include "registers/can.h"
#include "registers/core.h"
#include "registers/rcc.h"
#include "uptime.h"

#define RECEIVED 64u /* a power of two */
#define SENDING 32u  /* a power of two */
/* Polls for the acknowledgement of initialization mode, which from sleep mode depends on nothing on the bus
 * (RM0090, 32.4). A controller that does not give it stays in that mode, and the line silent. */
#define MODE_POLLS 100000u
/* What nobody acknowledged for so long is old. */
#define OLD_MS 100u

static const uint16_t host_ids[] = {
    WP_ESTOP_ID,          WP_HOST_HEARTBEAT_ID,    WP_TORQUE_FEEDFORWARD_ID, WP_WHEEL_COMMAND_ID,
    WP_TORQUE_COMMAND_ID, WP_TIME_SYNC_REQUEST_ID, WP_PARAMETER_REQUEST_ID,  WP_STEP_ID,
    WP_HELLO_REQUEST_ID,
};
#define HOST_IDS (sizeof host_ids / sizeof host_ids[0])
#define IDS_IN_A_BANK 4u
#define BANKS ((HOST_IDS + IDS_IN_A_BANK - 1u) / IDS_IN_A_BANK)

static struct {
    volatile wheel_frame received[RECEIVED];
    volatile uint32_t received_head; /* counts up for ever */
    volatile uint32_t received_tail;
    volatile wheel_frame sending[SENDING];
    volatile uint32_t sending_head;
    volatile uint32_t sending_tail;
    volatile uint32_t overruns;
    volatile uint32_t errors;
    volatile uint32_t bus_off;
    volatile uint32_t length_errors;
    uint32_t bus_off_told;
    volatile bool is_off;         /* each time off is counted once */
    volatile uint32_t leaving_ms; /* uptime when a frame last left, or nothing waited */
} host;

/* A standard data frame with this identifier, in a filter of 16 bits. */
static uint32_t filter_of(size_t index) {
    return (uint32_t)host_ids[index < HOST_IDS ? index : HOST_IDS - 1u] << 5;
}

static void open_filters(void) {
    CAN1->FMR |= CAN_FMR_FINIT;
    CAN1->FA1R = 0;
    CAN1->FS1R = 0;
    CAN1->FFA1R = 0;
    CAN1->FM1R = (1u << BANKS) - 1u;
    for (size_t bank = 0; bank < BANKS; bank++) {
        const size_t first = bank * IDS_IN_A_BANK;
        CAN1->FR[bank][0] = filter_of(first) | filter_of(first + 1u) << 16;
        CAN1->FR[bank][1] = filter_of(first + 2u) | filter_of(first + 3u) << 16;
    }
    CAN1->FA1R = (1u << BANKS) - 1u;
    CAN1->FMR &= ~CAN_FMR_FINIT;
}

void host_link_open(const clock_tree *clocks) {
    const board_can *own = &BOARD.host_can;
    (void)clocks; /* the bit timing of the board is for 42 MHz, the only bus clock there is */
    clock_enable(&RCC->APB1ENR, RCC_APB1ENR_CAN1);
    pin_to_peripheral(own->transmit);
    pin_to_peripheral(own->receive);
    CAN1->MCR = CAN_MCR_INRQ | CAN_MCR_TXFP | CAN_MCR_ABOM; /* and out of sleep */
    for (uint32_t i = 0; i < MODE_POLLS && (CAN1->MSR & CAN_MSR_INAK) == 0u; i++) {
    }
    if ((CAN1->MSR & CAN_MSR_INAK) == 0u) {
        return;
    }
    CAN1->BTR =
        CAN_BTR_BRP(own->prescaler) | CAN_BTR_TS1(own->bs1) | CAN_BTR_TS2(own->bs2) | CAN_BTR_SJW(own->sjw);
    open_filters();
    CAN1->IER =
        CAN_IER_TMEIE | CAN_IER_FMPIE0 | CAN_IER_FOVIE0 | CAN_IER_BOFIE | CAN_IER_LECIE | CAN_IER_ERRIE;
    CAN1->ESR = CAN_ESR_LEC; /* "set by software": an error will show as another value */
    interrupt_enable(CAN1_TX_IRQ);
    interrupt_enable(CAN1_RX0_IRQ);
    interrupt_enable(CAN1_SCE_IRQ);
    CAN1->MCR &= ~CAN_MCR_INRQ;
}

static void put(volatile wheel_frame *frame, const can_mailbox *mailbox) {
    const uint32_t low = mailbox->DLR;
    const uint32_t high = mailbox->DHR;
    frame->id = (uint16_t)(mailbox->IR >> 21);
    frame->length = (uint8_t)(mailbox->DTR & 0xFu);
    for (unsigned i = 0; i < 4u; i++) {
        frame->payload[i] = (uint8_t)(low >> (8u * i));
        frame->payload[4u + i] = (uint8_t)(high >> (8u * i));
    }
}

void can1_receive_interrupt(void) {
    uint32_t status;
    while (((status = CAN1->RFR[0]) & (CAN_RFR_FMP | CAN_RFR_FOVR)) != 0u) {
        if ((status & CAN_RFR_FOVR) != 0u) {
            host.overruns++;
            CAN1->RFR[0] = CAN_RFR_FOVR;
        }
        if ((status & CAN_RFR_FMP) == 0u) {
            continue;
        }
        if ((CAN1->receive[0].DTR & 0xFu) > WP_PAYLOAD_MAX) {
            host.length_errors++; /* ISO 11898-1 allows codes 9 to 15 for 8 bytes; this protocol does not */
        } else if (host.received_head - host.received_tail == RECEIVED) {
            host.overruns++;
        } else {
            put(&host.received[host.received_head % RECEIVED], &CAN1->receive[0]);
            host.received_head++;
        }
        CAN1->RFR[0] = CAN_RFR_RFOM;
    }
}

/* Fills the free mailboxes. */
static void transmit(void) {
    for (unsigned m = 0; m < 3u && host.sending_tail != host.sending_head; m++) {
        if ((CAN1->TSR & CAN_TSR_TME(m)) == 0u) {
            continue;
        }
        const volatile wheel_frame *frame = &host.sending[host.sending_tail % SENDING];
        uint32_t word[2] = {0, 0};
        for (unsigned i = 0; i < frame->length; i++) {
            word[i / 4u] |= (uint32_t)frame->payload[i] << (8u * (i % 4u));
        }
        can_mailbox *mailbox = &CAN1->transmit[m];
        mailbox->DTR = frame->length;
        mailbox->DLR = word[0];
        mailbox->DHR = word[1];
        mailbox->IR = CAN_IR_STID(frame->id) | CAN_IR_TXRQ;
        host.sending_tail++;
    }
}

void can1_transmit_interrupt(void) {
    CAN1->TSR = CAN_TSR_RQCP;
    host.leaving_ms = uptime_ms();
    transmit();
}

static void give_up_what_waits(void) {
    CAN1->TSR = CAN_TSR_ABRQ;
    host.sending_tail = host.sending_head;
}

/* Follows the controller off the bus and back. What was to be said is old when the bus is back. */
static void note_bus_off(uint32_t status) {
    const bool is_off = (status & CAN_ESR_BOFF) != 0u;
    if (is_off != host.is_off) {
        host.is_off = is_off;
        host.bus_off += is_off ? 1u : 0u;
        give_up_what_waits();
    }
}

void can1_status_interrupt(void) {
    CAN1->MSR = CAN_MSR_ERRI; /* first: what happens from here on is another interrupt */
    const uint32_t status = CAN1->ESR;
    if ((status & CAN_ESR_LEC) != 0u && (status & CAN_ESR_LEC) != CAN_ESR_LEC) {
        host.errors++;
    }
    CAN1->ESR = CAN_ESR_LEC;
    note_bus_off(status);
}

bool host_link_receive(wheel_frame *frame) {
    if (!host_link_has_received()) {
        return false;
    }
    *frame = host.received[host.received_tail % RECEIVED];
    host.received_tail++;
    return true;
}

bool host_link_has_received(void) {
    return host.received_tail != host.received_head;
}

bool host_link_has_room(void) {
    return host.sending_head - host.sending_tail < SENDING;
}

void host_link_send(const wheel_frame *frame) {
    if (host.is_off) {
        return;
    }
    host.sending[host.sending_head % SENDING] = *frame;
    interrupts_off();
    host.sending_head++;
    transmit();
    interrupts_on();
}

bool host_link_went_down(void) {
    interrupts_off();
    note_bus_off(CAN1->ESR);
    if ((CAN1->TSR & CAN_TSR_TME_ALL) == CAN_TSR_TME_ALL) {
        host.leaving_ms = uptime_ms();
    } else if (uptime_ms() - host.leaving_ms >= OLD_MS) {
        give_up_what_waits();
    }
    interrupts_on();
    const uint32_t count = host.bus_off;
    const bool down = count != host.bus_off_told;
    host.bus_off_told = count;
    return down;
}

void host_link_counters(wheel_transport_counters *counters) {
    counters->length = host.length_errors;
    counters->overrun = host.overruns;
    counters->can_errors = host.errors;
    counters->bus_off = host.bus_off;
}
