// Ticks of the controller's core as `update` makes them, with set-points that are random, late, missing, NaN, out of reach,
// of another frame, or jump. Prints how many set-points were taken and refused, in how many ticks the commands moved and
// rested, what was wrong, and how often they rested off the set-point. The machine and the readings of the start are in a file,
// member by member. With a third argument, the times of the ticks too.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <random>
#include "count_allocations.hpp"
#include "read_start.hpp"
#include "spm_set_points.hpp"
using namespace spm_robot;

int main(int count, char ** arguments)
{
  const long ticks = std::atol(arguments[1]);
  const bool is_timed = count > 3;
  constexpr double PERIOD = 0.001;
  constexpr double RATES[] = {0.1, 0.2, 0.1, 0.15, 0.1, 0.1}, ACCELERATIONS[] = {1.0, 1.5, 0.8, 1.0, 2.0, 1.0};
  Readings rate{}, acceleration{};
  std::copy_n(RATES, LEGS, rate.begin());
  std::copy_n(ACCELERATIONS, LEGS, acceleration.begin());
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> any(-1.0, 1.0);
  std::normal_distribution<double> normal;
  const auto one_in = [&](int n) {return random() % static_cast<unsigned>(n) == 0;};

  SetPoints set_points;
  const spm_geometry & machine = set_points.machine;
  Readings start{};
  if (!read_start(arguments[2], set_points.machine, start)) {return 3;}
  set_points.frame = "base";
  set_points.largest_step.fill(0.05);
  set_points.timeout = 0.5;
  set_points.period = PERIOD;
  Limiter limiter;
  limiter.configure(rate, acceleration, PERIOD);
  if (set_points.begin(start) != SPM_OK) {return 2;}
  limiter.begin(start, 0);

  std::vector<float> times;
  if (is_timed) {times.reserve(static_cast<std::size_t>(ticks));}
  Path path;
  Readings last = start, before = start;
  SetPoint wanted{"base", 0.0, {}, {}};
  spm_state state{};
  long taken = 0, refused = 0, wrong = 0, next_arrival = 1, rests = 0, moved = 0, off = 0, stops = 0, beyond = 0;
  Readings goal = start;
  for (long tick = 1; tick <= ticks; ++tick) {
    const double now = 1e3 + static_cast<double>(tick) * PERIOD;
    if (tick >= next_arrival) {
      // Twenty milliseconds apart, or late, or missing for a while.
      next_arrival = tick + (one_in(100) ? 2000 : one_in(20) ? 70 : 20) + static_cast<long>(random() % 3);
      // Poses come from readings: steps at random, now and then a jump or one beyond the limits.
      for (std::size_t i = 0; i < LEGS; ++i) {
        const double size = one_in(50) ? 0.3 : 0.004;
        goal[i] = path.serial ? path.at(path.serial).readings[i] + size * normal(random) : start[i];
      }
      // Legs that would be beyond their limits stand at them instead, in some of the set-points.
      bool is_at_stop = false;
      for (std::size_t i = 0; i < LEGS && tick % 4 == 0; ++i) {
        const double clamped = std::clamp(goal[i], machine.minimum[i], machine.maximum[i]);
        is_at_stop = is_at_stop || clamped != goal[i];
        goal[i] = clamped;
      }
      (void)spm_forward(&machine, goal.data(), nullptr, &state);
      const auto & r = state.rotation;
      const double w = 0.5 * std::sqrt(1.0 + r[0] + r[4] + r[8]);
      wanted.quaternion = {(r[7] - r[5]) / (4.0 * w), (r[2] - r[6]) / (4.0 * w), (r[3] - r[1]) / (4.0 * w), w};
      std::copy_n(state.position, 3, wanted.position.begin());
      wanted.stamp = now - 0.002 * std::fabs(any(random)) - (one_in(40) ? 0.6 : 0.0) - (one_in(40) ? 0.05 : 0.0);
      wanted.frame = one_in(40) ? "map" : "base";
      if (one_in(40)) {wanted.position[random() % 3] = NAN;}
      if (one_in(40)) {wanted.position[random() % 3] += 10.0 * any(random);}
      if (one_in(40)) {wanted.quaternion[random() % 4] = one_in(2) ? NAN : 2.0 * any(random);}
      const std::string reason = set_points.take(wanted, now, limiter.serial(), path);
      const bool is_taken = reason.empty();
      stops += is_at_stop;
      beyond += is_at_stop && reason.rfind("beyond limits", 0) == 0;
      taken += is_taken;
      refused += !is_taken;
      for (std::size_t i = 0; i < LEGS; ++i) {
        wrong += is_taken && !(path.at(path.serial).readings[i] >= machine.minimum[i] && path.at(path.serial).readings[i] <= machine.maximum[i]);
      }
    }
    const long allocated = allocations;
    const auto first = std::chrono::steady_clock::now();
    const Readings commands = limiter.tick(path);
    if (is_timed) {times.push_back(std::chrono::duration<float>(std::chrono::steady_clock::now() - first).count());}
    wrong += allocations != allocated;
    bool is_resting = true;
    for (std::size_t i = 0; i < LEGS; ++i) {
      const double speed = (commands[i] - last[i]) / PERIOD, change = (commands[i] - 2.0 * last[i] + before[i]) / (PERIOD * PERIOD);
      constexpr double ROUNDING = 4.0 * 2.3e-16;  // of the readings themselves
      wrong += !(std::fabs(speed) <= rate[i] + ROUNDING / PERIOD);
      wrong += !(std::fabs(change) <= acceleration[i] + 2.0 * ROUNDING / (PERIOD * PERIOD));
      wrong += !(commands[i] >= machine.minimum[i] && commands[i] <= machine.maximum[i]);
      is_resting = is_resting && commands[i] == last[i];
    }
    ++(is_resting ? rests : moved);
    for (std::size_t i = 0; i < LEGS && is_resting && path.serial && last == before; ++i) {
      off += std::fabs(commands[i] - path.at(path.serial).readings[i]) > 1e-12;
    }
    before = last;
    last = commands;
  }
  std::printf("taken %ld refused %ld wrong %ld rests %ld moved %ld off %ld", taken, refused, wrong, rests, moved, off);
  std::printf(" stops %ld beyond %ld", stops, beyond);
  if (is_timed) {
    const auto quantile = [&](double share) {
        const auto place = times.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(times.size() - 1));
        std::nth_element(times.begin(), place, times.end());
        return 1e6F * *place;
      };
    std::printf(" median %.3f us 99.99 %% %.3f us worst %.3f us over 20 us %ld", static_cast<double>(quantile(0.5)),
      static_cast<double>(quantile(0.9999)), static_cast<double>(quantile(1.0)),
      static_cast<long>(std::count_if(times.begin(), times.end(), [](float t) {return t > 20e-6F;})));
  }
  std::printf("\n");
  return 0;
}
