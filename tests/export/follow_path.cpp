// Set-points one after the other, one in each tick, and again where they come too fast. Prints the commands of all ticks. The
// first file has the machine, member by member, and the readings of the start; the second poses: positions and quaternions.
#include <cstdio>
#include <fstream>
#include "read_start.hpp"
#include "spm_set_points.hpp"
using namespace spm_robot;

int main(int, char ** arguments)
{
  constexpr double PERIOD = 0.001;
  SetPoints set_points;
  std::ifstream poses(arguments[2]);
  Readings start{}, rate{}, acceleration{};
  if (!read_start(arguments[1], set_points.machine, start)) {return 3;}
  rate.fill(0.1);
  acceleration.fill(1.0);
  set_points.frame = "base";
  set_points.largest_step.fill(0.05);
  set_points.timeout = 0.5;
  set_points.period = PERIOD;
  Limiter limiter;
  limiter.configure(rate, acceleration, PERIOD);
  if (set_points.begin(start) != SPM_OK) {return 2;}
  limiter.begin(start, 0);
  Path path;
  SetPoint wanted{"base", 0.0, {}, {}};
  bool is_waiting = false;
  for (long tick = 1, rest = 0; rest < 1000; ++tick) {
    is_waiting = is_waiting || [&] {
        for (double & x : wanted.position) {poses >> x;}
        for (double & x : wanted.quaternion) {poses >> x;}
        return !poses.fail();
      }();
    const std::string reason =
      is_waiting ? set_points.take(wanted, 1e-3 * static_cast<double>(tick), limiter.serial(), path) : "";
    if (!reason.empty() && reason.rfind("too fast", 0) != 0) {
      std::printf("%s\n", reason.c_str());
      return 1;
    }
    const bool is_taken = is_waiting && reason.empty();
    is_waiting = is_waiting && !is_taken;
    rest = is_taken || is_waiting || limiter.serial() < path.serial ? 0 : rest + 1;
    const Readings commands = limiter.tick(path);
    for (double x : commands) {std::printf("%.12f ", x);}
    std::printf("\n");
  }
  return 0;
}
