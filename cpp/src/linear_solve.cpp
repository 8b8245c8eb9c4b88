#include "linear_solve.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace monoloc {

void solve(double* matrix, double* right, std::size_t n) {
  for (std::size_t k = 0; k < n; ++k) {
    double* row = matrix + k * n;
    std::size_t largest = k;
    for (std::size_t i = k + 1; i < n; ++i) {
      if (std::abs(matrix[i * n + k]) > std::abs(matrix[largest * n + k])) largest = i;
    }
    if (largest != k) {
      std::swap_ranges(row + k, row + n, matrix + largest * n + k);
      std::swap(right[k], right[largest]);
    }
    if (row[k] == 0.0) throw std::domain_error("the normal matrix is singular");
    for (std::size_t i = k + 1; i < n; ++i) {
      double* below = matrix + i * n;
      const double factor = below[k] / row[k];
      for (std::size_t j = k + 1; j < n; ++j) below[j] -= factor * row[j];
      right[i] -= factor * right[k];
    }
  }
  for (std::size_t k = n; k-- > 0;) {
    for (std::size_t j = k + 1; j < n; ++j) right[k] -= matrix[k * n + j] * right[j];
    right[k] /= matrix[k * n + k];
  }
}

}  // namespace monoloc
