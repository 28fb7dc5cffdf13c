// Reading a file with the machine, member by member, and the readings of the start.
#pragma once

#include <cstdlib>
#include <fstream>
#include <string>

#include "spm_set_points.hpp"

// Return whether the file has both.
inline bool read_start(const char * path, spm_geometry & machine, spm_robot::Readings & start)
{
  std::ifstream file(path);
  std::string header;
  std::getline(file, header);
  const auto next = [&](const std::string & name, double * numbers, std::size_t size) {
      std::string word;
      file >> word;
      bool is_whole = word == name;
      for (std::size_t i = 0; i < size; ++i) {
        is_whole = is_whole && file >> word;
        numbers[i] = std::strtod(word.c_str(), nullptr);
      }
      return is_whole;
    };
  return spm_robot::read_machine(machine, next) && next("start", start.data(), start.size());
}
