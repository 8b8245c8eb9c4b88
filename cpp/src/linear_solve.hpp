// Linear systems of a few to some hundred unknowns.
#pragma once

#include <cstddef>

namespace monoloc {

// Solves matrix x = right, by Gaussian elimination with the largest pivot of each column. matrix (n, n), row-major, is
// destroyed; right (n) becomes x, which is NaN where the matrix is.
// Throws std::domain_error if the matrix is singular.
void solve(double* matrix, double* right, std::size_t n);

}  // namespace monoloc
