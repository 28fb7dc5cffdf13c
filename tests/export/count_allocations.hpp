// Counts what a program allocates, in `allocations`. To be included once, by its only source file.
#pragma once
#include <cstdlib>
#include <new>

static long allocations = 0;

void * operator new(std::size_t size)
{
  ++allocations;
  if (void * memory = std::malloc(size)) {return memory;}
  throw std::bad_alloc{};
}
void operator delete(void * memory) noexcept {std::free(memory);}
void operator delete(void * memory, std::size_t) noexcept {std::free(memory);}
