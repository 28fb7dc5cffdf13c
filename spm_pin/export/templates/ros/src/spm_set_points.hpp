// What the controller does, without ROS: `SetPoints` checks set-points where they arrive, and `Limiter` leads the legs to
// them, tick by tick.
//
// SPDX-License-Identifier: BSD-2-Clause

#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "{{prefix}}kinematics.h"

namespace {{package}}
{

constexpr std::size_t LEGS = {{zeros|length}};
using Readings = std::array<double, LEGS>;  // what the encoders show: metres, of cranks radians
constexpr double UNITS = 1099511627776.0;  // to a metre or a radian: readings are counted in them

// Read the members of a machine by their names with `read(name, numbers, count)`; returns whether it could read all.
template<typename Read>
bool read_machine({{prefix}}geometry & machine, const Read & read)
{
  constexpr struct {const char * name; std::size_t count;} FIELDS[] = { {{- PREFIX -}} FIELDS};
  double * numbers = reinterpret_cast<double *>(&machine);  // its members are numbers alone
  bool is_whole = true;
  for (const auto & field : FIELDS) {
    is_whole = read(field.name, numbers, field.count) && is_whole;
    numbers += field.count;
  }
  return is_whole;
}

// Readings to go to, from the first to the last tick of a number of them.
struct Target
{
  Readings readings{};
  std::int64_t ticks = 0;
};

// The last targets, and the number of the newest.
struct Path
{
  static constexpr std::uint64_t SIZE = 32;
  std::array<Target, SIZE> targets{};
  std::uint64_t serial = 0;

  Target & at(std::uint64_t number) {return targets[number % SIZE];}
  const Target & at(std::uint64_t number) const {return targets[number % SIZE];}
};

// A stamped pose of the platform, seen from a frame{{requested}}.
struct SetPoint
{
  std::string frame;
  double stamp = 0.0;  // [s], zero for the time of arrival
  std::array<double, 3> position{};
  std::array<double, 4> quaternion{};  // x, y, z, w
};

// Takes the set-points that are safe to follow. Not for the control loop: it compares strings, and the way to a pose beside a
// singularity takes milliseconds.
class SetPoints
{
public:
  std::string frame;
  std::vector<std::string> joints = std::vector<std::string>(LEGS);
  Readings largest_step{};  // of each reading, from the last set-point taken
  double timeout = 0.0;     // the largest age of a set-point that arrives [s]
  double period = 0.0;      // of the control loop [s]
  {{prefix}}geometry machine{};

  // Begin where the machine is; returns the status of its state.
  int begin(const Readings & readings)
  {
    last_stamp_ = -std::numeric_limits<double>::infinity();
    status_ = {{prefix}}forward(&machine, readings.data(), nullptr, &state_);
    return status_;
  }

  // Return why a set-point is refused, a few words and after a colon the details; or nothing, and the path that it continues.
  // `current` is the number of the target to which the Limiter moves.
  std::string take(const SetPoint & wanted, double now, std::uint64_t current, Path & path)
  {
    if (status_ != {{PREFIX}}OK) {return "not active";}
    if (path.serial - current >= Path::SIZE) {return "too fast: " + std::to_string(Path::SIZE) + " set-points are not reached yet";}
    if (wanted.frame != frame) {return "wrong frame: \"" + wanted.frame + "\" instead of \"" + frame + "\"";}
    const double stamp = wanted.stamp == 0.0 ? now : wanted.stamp;
    if (!(now - stamp <= timeout)) {return "stale: stamped " + std::to_string(now - stamp) + " s ago";}
    if (!(stamp - now <= timeout)) {return "in the future: by " + std::to_string(stamp - now) + " s";}
    if (!(stamp > last_stamp_)) {return "out of order: not stamped after the last one taken";}

    const auto & [x, y, z, w] = wanted.quaternion;
    if (!(std::fabs(x * x + y * y + z * z + w * w - 1.0) <= 1e-3)) {return "no unit quaternion";}
    const double s = 2.0 / (x * x + y * y + z * z + w * w);
    const std::array<double, 9> rotation = {
      1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w),
      s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w),
      s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y)};
    // On the branch that the machine is in: a pose may be held in two, and a jump from one to the other breaks it.
    {{prefix}}state next{}, reached{};
    const int status = {{prefix}}inverse(&machine, rotation.data(), wanted.position.data(), &state_, &next);
    if (status != {{PREFIX}}OK) {return {{prefix}}status_name(status);}
    const int beyond = {{prefix}}beyond_limits(&machine, next.readings);
    if (beyond != 0) {return "beyond limits: " + joints[beyond - 1];}
    for (std::size_t i = 0; i < LEGS; ++i) {
      // As the Limiter counts: a leg at its end stop may be beyond it by rounding.
      const double reading = std::clamp(next.readings[i], machine.minimum[i] + 1.0 / UNITS, machine.maximum[i] - 1.0 / UNITS);
      next.readings[i] = reading;
      const double step = std::fabs(reading - state_.readings[i]);
      if (!(step <= largest_step[i])) {return "jump: " + joints[i] + " by " + std::to_string(step);}
    }
    // The legs go another way than the platform would; it must end in the same state.
    if ({{prefix}}forward(&machine, next.readings, &state_, &reached) != {{PREFIX}}OK || !is_near(reached, next)) {
      return "singular: on the straight way of the legs";
    }
    state_ = next;
    Target & target = path.at(++path.serial);
    std::copy_n(next.readings, LEGS, target.readings.begin());
    target.ticks = stamp - last_stamp_ <= timeout ? std::llround((stamp - last_stamp_) / period) : 1;
    last_stamp_ = stamp;
    return "";
  }

private:
  {{prefix}}state state_{};  // of the last set-point taken
  int status_ = {{PREFIX}}BAD_NEAR;
  double last_stamp_ = 0.0;

  bool is_near(const {{prefix}}state & a, const {{prefix}}state & b) const
  {
    double error = 0.0;
    for (std::size_t i = 0; i < 9; ++i) {error = std::max(error, std::fabs(a.joints[i] - b.joints[i]));}
    return error <= 1e-6 * {{side}};
  }
};

// Leads readings along a path, from target to target, within limits of rate and acceleration. Between two targets, a way
// that is checked to be regular, the readings change in proportion: linearly in the time between the set-points, faster where
// further ones wait, and longer where a leg would be too fast. The commands are the means of the last ticks, in number such that
// twice the largest rate is gained in them at the largest acceleration. A mean of readings within limits is within them, is
// never faster than they are, and never goes beyond the end; it rounds corners, by at most rate^2 / (2 acceleration).
//
// Readings are counted in units of 2^-40 of theirs, so that sums of them are exact however long the controller runs.
class Limiter
{
public:
  // Allocates, as nothing below does.
  void configure(const Readings & rate, const Readings & acceleration, double period)
  {
    double ticks = 1.0;
    for (std::size_t i = 0; i < LEGS; ++i) {
      step_[i] = rate[i] * period * UNITS - 1.0;  // one unit less, for rounding
      ticks = std::max(ticks, std::ceil(2.0 * rate[i] / (acceleration[i] * period)));
    }
    past_.resize(static_cast<std::size_t>(ticks));
  }

  // Stay at readings, until a target comes with a larger number than this.
  void begin(const Readings & readings, std::uint64_t serial)
  {
    for (std::size_t i = 0; i < LEGS; ++i) {
      from_[i] = to_[i] = now_[i] = std::llround(readings[i] * UNITS);
      sum_[i] = now_[i] * static_cast<std::int64_t>(past_.size());
    }
    std::fill(past_.begin(), past_.end(), now_);
    tick_ = ticks_ = 0;
    serial_ = serial;
  }

  // The number of the target to which it moves.
  std::uint64_t serial() const {return serial_;}

  // The commands of the next tick.
  Readings tick(const Path & path)
  {
    if (tick_ == ticks_ && path.serial > serial_) {
      const Target & target = path.at(++serial_);
      const auto waiting = static_cast<std::int64_t>(path.serial - serial_);
      tick_ = 0;
      ticks_ = std::max<std::int64_t>(target.ticks / (1 + waiting), 1);
      from_ = now_;
      for (std::size_t i = 0; i < LEGS; ++i) {
        to_[i] = std::llround(target.readings[i] * UNITS);
        const double least = std::ceil(static_cast<double>(std::llabs(to_[i] - from_[i])) / step_[i]);
        ticks_ = std::max(ticks_, static_cast<std::int64_t>(least));
      }
    }
    tick_ = std::min(tick_ + 1, ticks_);
    const double share = ticks_ > 0 ? static_cast<double>(tick_) / static_cast<double>(ticks_) : 1.0;
    next_ = next_ + 1 < past_.size() ? next_ + 1 : 0;
    Readings commands{};
    for (std::size_t i = 0; i < LEGS; ++i) {
      now_[i] = from_[i] + std::llround(share * static_cast<double>(to_[i] - from_[i]));
      sum_[i] += now_[i] - past_[next_][i];
      past_[next_][i] = now_[i];
      commands[i] = static_cast<double>(sum_[i]) / (UNITS * static_cast<double>(past_.size()));
    }
    return commands;
  }

private:
  using Counts = std::array<std::int64_t, LEGS>;

  Readings step_{};                       // the most in a tick
  Counts from_{}, to_{}, now_{}, sum_{};  // the way to the target, and the sum of `past_`
  std::vector<Counts> past_ = std::vector<Counts>(1);
  std::size_t next_ = 0;
  std::int64_t tick_ = 0, ticks_ = 0;
  std::uint64_t serial_ = 0;
};

}  // namespace {{package}}
