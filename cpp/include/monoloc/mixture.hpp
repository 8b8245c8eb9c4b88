// Gaussian mixture in three dimensions: exact density and the E-step of EM.
#pragma once

#include <cstddef>
#include <vector>

#include "monoloc/kernels.hpp"

namespace monoloc {

// Components from weights (K), means (K, 3) and covariances (K, 3, 3), row-major.
// Throws std::invalid_argument if a covariance is not positive definite.
std::vector<Component> make_components(const double* weights, const double* means, const double* covariances,
                                       std::size_t count);

// Natural logarithm of the mixture's density at points (P, 3); exact over all components.
void log_density(const std::vector<Component>& mixture, const double* points, std::size_t count, double* out);

// Sufficient statistics of the M-step, relative to the current means to avoid cancellation.
struct Expectation {
  std::vector<double> mass;     // (K): sum_n r_nk
  std::vector<double> first;    // (K, 3): sum_n r_nk d_nk
  std::vector<double> second;   // (K, 6): sum_n r_nk d_nk d_nk^T, entries xx xy xz yy yz zz
  double log_likelihood = 0.0;  // sum_n log p(x_n)
};

Expectation expectation(const std::vector<Component>& mixture, const double* points, std::size_t count);

}  // namespace monoloc
