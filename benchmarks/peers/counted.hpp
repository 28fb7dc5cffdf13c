// A double that counts what is done to it: for the operations per pose in the roofline of the benchmarks.
#pragma once

#include <cmath>
#include <cstdint>

extern "C" {
// Additions and subtractions, multiplications, divisions, square roots.
int64_t operations[4] = {0, 0, 0, 0};
}

struct real {
    double value;
    real() = default;
    real(double v) : value(v) {}
    explicit operator double() const { return value; }
};

inline real operator+(real a, real b) { ++operations[0]; return a.value + b.value; }
inline real operator-(real a, real b) { ++operations[0]; return a.value - b.value; }
inline real operator*(real a, real b) { ++operations[1]; return a.value * b.value; }
inline real operator/(real a, real b) { ++operations[2]; return a.value / b.value; }
inline real sqrt(real a) { ++operations[3]; return std::sqrt(a.value); }
// Signs and comparisons are not counted.
inline real operator-(real a) { return -a.value; }
inline real fabs(real a) { return std::fabs(a.value); }
inline bool operator<(real a, real b) { return a.value < b.value; }
inline bool operator>(real a, real b) { return a.value > b.value; }
inline bool operator<=(real a, real b) { return a.value <= b.value; }
inline bool operator>=(real a, real b) { return a.value >= b.value; }
