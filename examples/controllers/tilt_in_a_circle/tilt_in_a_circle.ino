/* A plate on three servos tilts in a circle: 10 degrees, once in four seconds.

   For boards that Arduino knows, with its library Servo, on an ESP32 with the library ESP32Servo. Beside this file belongs stage.h, from
   `spm-pin export c-stage`. */

#ifdef ARDUINO_ARCH_ESP32
#include <ESP32Servo.h>
const int PINS[3] = {4, 13, 14}; /* of ESP32, S2 and S3; the C3 has others */
#else
#include <Servo.h>
const int PINS[3] = {9, 10, 11};
#endif

#include "stage.h"

/* Of each servo the pulse at which its crank is level, outwards, and what a radian upwards adds or takes off. */
const float LEVEL_PULSE[3] = {1500.0f, 1500.0f, 1500.0f};
const float PULSE_PER_RADIAN[3] = {637.0f, 637.0f, 637.0f};

/* True: the servos go to readings of 0 and of 0.5 rad in turn, for four seconds each. The plate has to be level both
   times; the page on ball balancers says what is wrong where it leans. */
const bool CHECK = false;

const float TILT = 0.1745f, TURNS_PER_SECOND = 0.25f;

Servo servos[3];
stage_state state;

void setup()
{
    Serial.begin(115200);
    for (int i = 0; i < 3; ++i) {
        servos[i].attach(PINS[i]);
    }
}

void loop()
{
    float azimuth = 6.2831853f * TURNS_PER_SECOND * 0.001f * (float)(millis() % 4000);
    int status = STAGE_OK;
    if (CHECK) {
        for (int i = 0; i < 3; ++i) {
            state.readings[i] = millis() % 8000 < 4000 ? 0.0f : 0.5f;
        }
    } else {
        status = stage_tilt(&stage_machine, TILT, azimuth, stage_machine.home_height, &state);
    }
    if (status != STAGE_OK) {
        Serial.println(status); /* the servos stay where they are */
    } else {
        for (int i = 0; i < 3; ++i) {
            servos[i].writeMicroseconds((int)(LEVEL_PULSE[i] + PULSE_PER_RADIAN[i] * state.readings[i] + 0.5f));
        }
    }
    delay(20);
}
