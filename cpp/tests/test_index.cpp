// The indexed map: density, and likelihood of particles.
#include <cmath>
#include <vector>

#include "check.hpp"
#include "monoloc/index.hpp"
#include "room.hpp"
#include "tests.hpp"

void test_index() {
  const Room room(100);
  const double floor = 0.01, tolerance = 0.02;
  const monoloc::MixtureIndex index(room.components, {0.1, floor, tolerance});
  const std::size_t count = 5000;
  const std::vector<double> x = room.points(count, 0.2);
  std::vector<double> result(count);
  index.log_density(x.data(), count, result.data());
  double worst = 0.0;
  for (std::size_t i = 0; i < count; ++i) {
    const double exact = std::log(room.density(&x[3 * i]) + floor);
    worst = std::max(worst, std::abs(std::log(std::exp(result[i]) + floor) - exact));
  }
  CHECK(worst < 2.0 * tolerance);
  // Built by several threads, it is the same index.
  const monoloc::MixtureIndex shared(room.components, {0.02, floor, tolerance, 5});
  const monoloc::MixtureIndex alone(room.components, {0.02, floor, tolerance, 1});
  std::vector<double> of_shared(count), of_alone(count);
  shared.log_density(x.data(), count, of_shared.data());
  alone.log_density(x.data(), count, of_alone.data());
  CHECK(shared.voxels() > 100000 && shared.voxels() == alone.voxels() && shared.bytes() == alone.bytes());
  CHECK(of_shared == of_alone);
  const double far[3] = {1e6, -1e9, 0.0};
  index.log_density(far, 1, result.data());
  CHECK(std::isinf(result[0]) && result[0] < 0.0);

  // For two particles, one with a scale: equal to the density at explicitly transformed points.
  const double poses[32] = {0, -1, 0, 0.1, 1, 0, 0, 0.2, 0, 0, 1, -0.1, 0, 0, 0, 1,
                            1, 0,  0, 0.0, 0, 1, 0, 0.0, 0, 0, 1, 0.0,  0, 0, 0, 1};
  const double log_scales[2] = {std::log(1.5), 0.0};
  const float scan[6] = {0.2f, 0.1f, 0.3f, -0.4f, 0.2f, 0.1f}, weights[2] = {2.0f, 0.5f};
  double weighed[2];
  index.weigh(poses, log_scales, 2, scan, weights, 2, 0.2, 20.0, weighed);
  double expected = 0.0;
  for (int p = 0; p < 2; ++p) {
    const double s[3] = {1.5 * scan[3 * p], 1.5 * scan[3 * p + 1], 1.5 * scan[3 * p + 2]};
    const double moved[3] = {-s[1] + 0.1, s[0] + 0.2, s[2] - 0.1};
    expected += weights[p] * std::log(0.8 * room.density(moved) + 0.2 / 20.0);
  }
  CHECK(std::abs(weighed[0] - expected) < 2.0 * tolerance * 2.5);
}
