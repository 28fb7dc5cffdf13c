/* A stand-in for the part of the library ESP32Servo that the sketches use. */
#ifndef ESP32_SERVO_H
#define ESP32_SERVO_H

class Servo {
public:
    int attach(int on)
    {
        pin = on;
        return 1; /* a channel */
    }
    void writeMicroseconds(int pulse); /* prints the time in ms, the pin and the pulse */

private:
    int pin = -1;
};

#endif
