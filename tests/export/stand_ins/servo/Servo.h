#ifndef SERVO_H
#define SERVO_H

struct Servo {
    int pin = -1;
    void attach(int on) { pin = on; }
    void writeMicroseconds(int pulse); /* prints the time in ms, the pin and the pulse */
};

#endif
