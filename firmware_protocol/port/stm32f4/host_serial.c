#include "board.h"
#include "host_link.h"
#include "usart.h"

static struct {
    usart line;
    wheel_deframer deframer;
    uint8_t sequence; /* of the next frame sent */
} host;

void host_link_open(const clock_tree *clocks) {
    wheel_deframer_init(&host.deframer);
    usart_open(&host.line, &BOARD.host_serial, clocks);
}

bool host_link_receive(wheel_frame *frame) {
    uint8_t byte;
    while (usart_receive(&host.line, &byte)) {
        if (wheel_deframer_feed(&host.deframer, byte, frame)) {
            return true;
        }
    }
    return false;
}

bool host_link_has_received(void) {
    return usart_has_received(&host.line);
}

bool host_link_has_room(void) {
    return usart_room(&host.line) >= WHEEL_FRAME_MAX;
}

void host_link_send(const wheel_frame *frame) {
    uint8_t bytes[WHEEL_FRAME_MAX];
    usart_send(&host.line, bytes, wheel_frame_encode(frame, host.sequence++, bytes));
}

bool host_link_went_down(void) {
    return false; /* a serial line does not tell; silence stops the robot */
}

void host_link_counters(wheel_transport_counters *counters) {
    counters->cobs = host.deframer.cobs;
    counters->crc = host.deframer.crc;
    counters->length = host.deframer.length_errors;
    counters->unknown_id = host.deframer.unknown_id;
    counters->overrun = host.deframer.overruns + host.line.overruns;
    counters->serial_lost = host.deframer.lost;
}
