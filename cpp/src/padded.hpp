// Rows of values, padded to whole SIMD vectors.
#pragma once

#include <cstddef>
#include <vector>

#include "monoloc/kernels.hpp"

namespace monoloc {

inline std::size_t padded(std::size_t count) { return (count + kPadding - 1) / kPadding * kPadding; }

// (P, 3) points as three padded rows of x - centre; padding repeats the last point.
template <class T>
std::vector<T> padded_rows(const double* points, std::size_t count, const double* centre) {
  const std::size_t stride = padded(count);
  std::vector<T> rows(3 * stride);
  for (std::size_t i = 0; i < stride; ++i) {
    const double* point = points + 3 * (i < count ? i : count - 1);
    for (std::size_t axis = 0; axis < 3; ++axis) rows[axis * stride + i] = static_cast<T>(point[axis] - centre[axis]);
  }
  return rows;
}

}  // namespace monoloc
