#include "robot.h"

int main(void) {
    static robot own;
    robot_start(&own);
    for (;;) {
        robot_serve(&own);
        robot_tick(&own);
        robot_idle(&own);
    }
}
