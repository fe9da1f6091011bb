#ifndef WHEEL_APP_H
#define WHEEL_APP_H

void wheel_app_start(void);
void wheel_app_run(void);
void wheel_app_motors_off(void);

#endif
