// Poses and focal lengths of landmarks, from points that a camera at the origin sees exactly.
#include <cmath>
#include <cstddef>
#include <limits>
#include <stdexcept>
#include <vector>

#include "check.hpp"
#include "monoloc/landmark_pose.hpp"
#include "tests.hpp"

namespace {

constexpr double kKernels[] = {24.0, 12.0, 6.0, 3.0, 3.0, 3.0};
constexpr std::size_t kPoints = 60;

std::vector<double> diagonal(std::size_t size, double value) {
  std::vector<double> matrix(size * size, 0.0);
  for (std::size_t i = 0; i < size; ++i) matrix[i * size + i] = value;
  return matrix;
}

struct Scene {
  std::vector<double> points, rays, sd;

  explicit Scene(double focal = 1.0) {
    for (std::size_t i = 0; i < kPoints; ++i) {
      const double n = static_cast<double>(i), z = 2.0 + std::sin(1.7 * n);
      const double x = 0.6 * std::sin(0.9 * n), y = 0.4 * std::cos(2.3 * n);
      points.insert(points.end(), {x * z, y * z, z});
      rays.insert(rays.end(), {focal * x, focal * y});
      sd.insert(sd.end(), {0.004, 0.004});
    }
  }

  monoloc::SeenLandmarks seen() const { return {points.data(), rays.data(), sd.data(), kPoints, 0.05}; }
};

// Of a camera that is turned a little about y, and stands beside.
std::vector<double> near_pose() {
  const double c = std::cos(0.02), s = std::sin(0.02);
  return {c, 0, s, 0.03, 0, 1, 0, -0.02, -s, 0, c, 0.04, 0, 0, 0, 1};
}

monoloc::PoseFit fitted(const Scene& scene, const std::vector<double>& prior, double information) {
  return monoloc::fit_pose(scene.seen(), prior.data(), diagonal(6, information).data(), {kKernels, 6});
}

}  // namespace

void test_landmark_pose() {
  // Every tenth is a wrong match, which must not agree; the others lead back to the origin.
  Scene scene;
  for (std::size_t i = 0; i < kPoints; i += 10) scene.rays[2 * i] += 0.2;
  const monoloc::PoseFit fit = fitted(scene, near_pose(), 1e-3);
  const std::vector<double> origin = diagonal(4, 1.0);
  for (std::size_t i = 0; i < 16; ++i) CHECK(std::abs(fit.pose[i] - origin[i]) < 1e-4);
  for (std::size_t i = 0; i < kPoints; ++i) CHECK((fit.weights[i] > 0.25) == (i % 10 != 0));
  for (std::size_t i = 0; i < 6; ++i) {
    CHECK(fit.normal[7 * i] > 0.0);
    for (std::size_t j = 0; j < 6; ++j) CHECK(fit.normal[6 * i + j] == fit.normal[6 * j + i]);
  }
  // Every landmark has a leverage, in proportion to its weight.
  std::vector<double> all(kPoints, 1.0);
  double sum = 0.0;
  for (const double leverage : monoloc::leverages(scene.seen(), origin.data(), diagonal(6, 1e-4).data(), all.data())) {
    CHECK(leverage > 0.0);
    sum += leverage;
  }
  const std::vector<double> half(kPoints, 0.5);
  double halved = 0.0;
  for (const double leverage : monoloc::leverages(scene.seen(), origin.data(), diagonal(6, 1e-4).data(), half.data())) {
    halved += leverage;
  }
  CHECK(std::abs(halved - 0.5 * sum) < 1e-9 * sum);

  // A prior that is certain stays.
  const std::vector<double> prior = near_pose();
  const monoloc::PoseFit kept = fitted(Scene(), prior, 1e14);
  for (std::size_t i = 0; i < 16; ++i) CHECK(std::abs(kept.pose[i] - prior[i]) < 1e-6);

  // The focal length by which the rays are too long.
  const monoloc::LogRatio focal =
      monoloc::fit_log_focal(Scene(1.05).seen(), origin.data(), diagonal(7, 1e-3).data(), {kKernels, 6});
  CHECK(std::abs(focal.value - std::log(1.05)) < 1e-6);
  CHECK(focal.sd > 0.0 && focal.sd < 0.01);

  // And the aspect, whatever the focal length is.
  Scene stretched(1.05);
  for (std::size_t i = 0; i < kPoints; ++i) stretched.rays[2 * i + 1] *= 1.1;
  const monoloc::LogRatio aspect =
      monoloc::fit_log_aspect(stretched.seen(), origin.data(), diagonal(8, 1e-3).data(), {kKernels, 6});
  CHECK(std::abs(aspect.value - std::log(1.1)) < 1e-6);
  CHECK(aspect.sd > 0.0 && aspect.sd < 0.01);

  // A NaN reaches all weights; without information there is no solution.
  Scene broken;
  broken.rays[7] = std::numeric_limits<double>::quiet_NaN();
  for (const double weight : fitted(broken, prior, 1.0).weights) CHECK(std::isnan(weight));
  bool thrown = false;
  try {
    monoloc::fit_pose({nullptr, nullptr, nullptr, 0, 0.05}, prior.data(), diagonal(6, 0.0).data(), {kKernels, 6});
  } catch (const std::domain_error&) {
    thrown = true;
  }
  CHECK(thrown);
}
