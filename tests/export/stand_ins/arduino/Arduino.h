/* A stand-in for the part of Arduino that the sketches use: see board.cpp. */
#ifndef ARDUINO_H
#define ARDUINO_H

#include <stddef.h>
#include <stdint.h>

unsigned long millis();
void delay(unsigned long milliseconds);

struct SerialPort {
    void begin(unsigned long) {}
    int available();
    int read();
    size_t write(const uint8_t *bytes, size_t count);
    void println(int number);
};
extern SerialPort Serial;

#endif
