// The map of the tests, with its density by plain loops in double precision.
#pragma once

#include <cmath>
#include <random>
#include <vector>

#include "monoloc/mixture.hpp"

// A room of flat components: weights, means (K, 3), covariances (K, 3, 3).
struct Room {
  std::vector<double> weights, means, covariances;
  std::vector<monoloc::Component> components;

  explicit Room(std::size_t count) : means(3 * count), covariances(9 * count, 0.0) {
    std::mt19937_64 random(1);
    std::uniform_real_distribution<double> place(-1.0, 1.0);
    weights.assign(count, 1.0 / static_cast<double>(count));
    for (double& m : means) m = place(random);
    const double sigma[3] = {0.15, 0.1, 0.015};
    for (std::size_t k = 0; k < count; ++k) {
      // Covariance = B diag(sigma^2) B^T for a random shear B, which is positive definite.
      double b[9];
      for (int i = 0; i < 9; ++i) b[i] = (i % 4 == 0 ? 1.0 : 0.0) + 0.5 * place(random);
      for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
          for (int m = 0; m < 3; ++m) covariances[9 * k + 3 * i + j] += b[3 * i + m] * b[3 * j + m] * sigma[m] * sigma[m];
        }
      }
    }
    components = monoloc::make_components(weights.data(), means.data(), covariances.data(), count);
  }

  // weight * density of component k at x.
  double density(std::size_t k, const double* x) const {
    const monoloc::Component& c = components[k];
    const double d[3] = {x[0] - c.mean[0], x[1] - c.mean[1], x[2] - c.mean[2]};
    const double* w = c.whiten;
    const double y[3] = {w[0] * d[0], w[1] * d[0] + w[2] * d[1], w[3] * d[0] + w[4] * d[1] + w[5] * d[2]};
    return std::exp2(c.log2_peak - y[0] * y[0] - y[1] * y[1] - y[2] * y[2]);
  }

  double density(const double* x) const {
    double sum = 0.0;
    for (std::size_t k = 0; k < components.size(); ++k) sum += density(k, x);
    return sum;
  }

  // Random points around the components' means.
  std::vector<double> points(std::size_t count, double spread) const {
    std::mt19937_64 random(2);
    std::normal_distribution<double> normal(0.0, spread);
    std::vector<double> x(3 * count);
    for (std::size_t i = 0; i < x.size(); ++i) x[i] = means[i % means.size()] + normal(random);
    return x;
  }
};
