/* A board for the sketches. `board MILLISECONDS PORT` runs in the computer's time on a serial port, until nothing has come
   for so long; without a port a millisecond passes at each loop, and the standard input comes in as on a line of 115200
   baud. */

#include "Arduino.h"

#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

#ifdef ARDUINO_ARCH_ESP32
#include <ESP32Servo.h>
#else
#include <Servo.h>
#endif

void setup();
void loop();

SerialPort Serial;

static unsigned long now, arrived, heard;
static int port = -1, byte = EOF;

static unsigned long computer_time()
{
    timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (unsigned long)(t.tv_sec * 1000 + t.tv_nsec / 1000000);
}

unsigned long millis() { return now; }

void delay(unsigned long milliseconds) { now += milliseconds; }

int SerialPort::available()
{
    unsigned char one;
    if (byte == EOF && port >= 0) {
        byte = ::read(port, &one, 1) == 1 ? one : EOF;
        heard = byte == EOF ? heard : now;
    } else if (byte == EOF && arrived < now * 11520 / 1000) {
        byte = getchar();
        ++arrived;
    }
    return byte != EOF;
}

int SerialPort::read()
{
    int one = byte;
    byte = EOF;
    return one;
}

size_t SerialPort::write(const uint8_t *bytes, size_t count)
{
    return port >= 0 && ::write(port, bytes, count) == (ssize_t)count ? count : 0;
}

void SerialPort::println(int number) { printf("# %d\n", number); }

void Servo::writeMicroseconds(int pulse) { printf("%lu %d %d\n", now, pin, pulse); }

int main(int count, char **arguments)
{
    unsigned long start = computer_time(), length = strtoul(arguments[1], 0, 10);
    port = count > 2 ? open(arguments[2], O_RDWR | O_NOCTTY | O_NONBLOCK) : -1;
    heard = port >= 0 ? 60000 : 0; /* of the first byte, a minute is waited for */
    for (setup(); now < heard + length; now = port >= 0 ? computer_time() - start : now + 1) {
        loop();
        if (port >= 0) {
            usleep(200);
        }
    }
    return 0;
}
