/* Three servos follow set-points from a serial line, within limits and watched: see set_points.h.

   For boards that Arduino knows, with its library Servo, on an ESP32 with the library ESP32Servo. Beside this file belong set_points.h and stage.h, from
   `spm-pin export c-stage`. The other end of the line is stream_set_points.py. */

#ifdef ARDUINO_ARCH_ESP32
#include <ESP32Servo.h>
const int PINS[3] = {4, 13, 14}; /* of ESP32, S2 and S3; the C3 has others */
#else
#include <Servo.h>
const int PINS[3] = {9, 10, 11};
#endif

#include "set_points.h"

/* Of each servo the pulse at which its crank is level, outwards, and what a radian upwards adds or takes off. */
const float LEVEL_PULSE[3] = {1500.0f, 1500.0f, 1500.0f};
const float PULSE_PER_RADIAN[3] = {637.0f, 637.0f, 637.0f};

const float RATE = 4.0f, ACCELERATION = 40.0f, PATIENCE = 0.25f; /* rad/s, rad/s^2, s */
const unsigned long PERIOD = 10;                                  /* of the commands [ms] */

Servo servos[3];
set_points points;
unsigned long last_time;

void setup()
{
    stage_state home;
    Serial.begin(115200);
    if (stage_tilt(&stage_machine, 0.0f, 0.0f, stage_machine.home_height, &home) != STAGE_OK) {
        for (;;) {
        } /* a machine that does not reach its home is not driven */
    }
    set_points_begin(&points, &stage_machine, &home, RATE, ACCELERATION, PATIENCE);
    for (int i = 0; i < 3; ++i) {
        servos[i].attach(PINS[i]);
    }
    last_time = millis();
}

void loop()
{
    uint8_t answer[ANSWER_SIZE];
    while (Serial.available() > 0) {
        if (set_points_take(&points, (uint8_t)Serial.read(), answer)) {
            Serial.write(answer, ANSWER_SIZE);
        }
    }
    /* The time of a step is fixed: where the loop is late the command waits and does not jump. */
    if (millis() - last_time >= PERIOD) {
        last_time = millis();
        set_points_move(&points, 0.001f * PERIOD);
        for (int i = 0; i < 3; ++i) {
            servos[i].writeMicroseconds((int)(LEVEL_PULSE[i] + PULSE_PER_RADIAN[i] * points.state.readings[i] + 0.5f));
        }
    }
}
