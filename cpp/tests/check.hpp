// A check that reports and counts failures without stopping.
#pragma once

#include <cstdio>

inline int failures = 0;

inline void check(bool holds, const char* what, const char* file, int line) {
  if (holds) return;
  std::printf("%s:%d: %s\n", file, line, what);
  ++failures;
}
#define CHECK(condition) check((condition), #condition, __FILE__, __LINE__)
