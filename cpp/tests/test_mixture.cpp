// Densities and statistics of EM in double precision.
#include <cmath>
#include <stdexcept>
#include <vector>

#include "check.hpp"
#include "monoloc/mixture.hpp"
#include "room.hpp"
#include "tests.hpp"

void test_whitening() {
  // The density for a diagonal covariance has a simple closed form.
  const double weight = 1.0, mean[3] = {1.0, 2.0, 3.0}, covariance[9] = {4.0, 0, 0, 0, 9.0, 0, 0, 0, 0.25};
  const auto components = monoloc::make_components(&weight, mean, covariance, 1);
  const double x[3] = {3.0, 5.0, 3.5};  // one standard deviation along each axis
  double result = 0.0;
  monoloc::log_density(components, x, 1, &result);
  const double expected = -1.5 - 1.5 * std::log(2.0 * 3.14159265358979323846) - std::log(2.0 * 3.0 * 0.5);
  CHECK(std::abs(result - expected) < 1e-12);
}

void test_rejects_indefinite() {
  const double weight = 1.0, mean[3] = {}, covariance[9] = {1.0, 2.0, 0, 2.0, 1.0, 0, 0, 0, 1.0};
  bool thrown = false;
  try {
    monoloc::make_components(&weight, mean, covariance, 1);
  } catch (const std::invalid_argument&) {
    thrown = true;
  }
  CHECK(thrown);
}

void test_log_density_and_expectation() {
  const Room room(30);
  const std::size_t count = 101;  // not a multiple of any vector length
  const std::vector<double> x = room.points(count, 0.3);
  std::vector<double> result(count);
  monoloc::log_density(room.components, x.data(), count, result.data());
  double worst = 0.0, log_likelihood = 0.0, mass = 0.0, second = 0.0;
  for (std::size_t i = 0; i < count; ++i) {
    const double total = room.density(&x[3 * i]);
    worst = std::max(worst, std::abs(result[i] - std::log(total)));
    log_likelihood += std::log(total);
    const double r = room.density(7, &x[3 * i]) / total;
    mass += r;
    second += r * (x[3 * i] - room.means[21]) * (x[3 * i + 2] - room.means[23]);
  }
  CHECK(worst < 1e-11);
  const monoloc::Expectation e = monoloc::expectation(room.components, x.data(), count);
  CHECK(std::abs(e.log_likelihood - log_likelihood) < 1e-9);
  CHECK(std::abs(e.mass[7] - mass) < 1e-11);
  CHECK(std::abs(e.second[6 * 7 + 2] - second) < 1e-11);
  double all = 0.0;
  for (const double m : e.mass) all += m;
  CHECK(std::abs(all - static_cast<double>(count)) < 1e-9);
}
