// The largest of five values in a row, of integer keys; part of kernels.cpp, see there.
#pragma once

#include <cstddef>
#include <cstdint>

namespace monoloc {
namespace {

// Plain loops over contiguous integers: the compiler makes vectors of them.
void largest_of_five(const std::int32_t* const* rows, std::size_t count, std::int32_t* out) {
  const std::int32_t *a = rows[0], *b = rows[1], *c = rows[2], *d = rows[3], *e = rows[4];
  for (std::size_t i = 0; i < count; ++i) {
    const std::int32_t ab = a[i] > b[i] ? a[i] : b[i];
    const std::int32_t cd = c[i] > d[i] ? c[i] : d[i];
    const std::int32_t abcd = ab > cd ? ab : cd;
    out[i] = abcd > e[i] ? abcd : e[i];
  }
}

}  // namespace
}  // namespace monoloc
