// Bundle adjustment of three keyframes that look at the same corners, and the products of columns that it needs.
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "check.hpp"
#include "monoloc/kernels.hpp"
#include "monoloc/window.hpp"
#include "tests.hpp"

namespace {

constexpr std::size_t kFrames = 3, kCorners = 40;
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// Keyframes side by side, 20 cm apart.
struct Scene {
  std::vector<double> poses, points, rays, log_depth;

  Scene() {
    for (std::size_t w = 0; w < kFrames; ++w) {
      poses.insert(poses.end(), {1, 0, 0, 0.2 * static_cast<double>(w), 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1});
    }
    for (std::size_t n = 0; n < kCorners; ++n) {
      const double at = static_cast<double>(n), z = 2.0 + std::sin(1.7 * at);
      points.insert(points.end(), {std::sin(0.9 * at) * z, std::cos(2.3 * at) * z, z});
      for (std::size_t w = 0; w < kFrames; ++w) {
        rays.insert(rays.end(), {(points[3 * n] - poses[16 * w + 3]) / z, points[3 * n + 1] / z});
        log_depth.push_back(std::log(z));
      }
    }
  }

  // Adjusts copies of poses and points; returns the points' information.
  std::vector<double> adjusted(std::vector<double>& moved, std::vector<double>& placed) const {
    std::vector<double> information(9 * kCorners);
    monoloc::adjust_window({rays.data(), log_depth.data(), kCorners, kFrames, 0.002, 0.1}, 8, moved.data(),
                           placed.data(), information.data());
    return information;
  }
};

double worst_difference(const std::vector<double>& a, const std::vector<double>& b) {
  double worst = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) worst = std::max(worst, std::abs(a[i] - b[i]));
  return std::isnan(worst) ? 1.0 : worst;
}

}  // namespace

void test_window() {
  Scene scene;
  for (std::size_t n = 0; n < kCorners; n += 7) {  // missing, in whole or in part
    scene.rays[2 * (n * kFrames + 1)] = kNaN;
    scene.log_depth[n * kFrames + 2] = kNaN;
  }
  for (std::size_t i = 0; i < 2 * kFrames; ++i) scene.rays[i] = kNaN;
  for (std::size_t i = 0; i < kFrames; ++i) scene.log_depth[i] = kNaN;
  std::vector<double> poses = scene.poses, points = scene.points;
  poses[16 + 3] += 0.01;
  poses[32 + 7] -= 0.01;
  for (std::size_t i = 3; i < points.size(); ++i) points[i] += 0.02 * std::sin(static_cast<double>(i));
  const std::vector<double> information = scene.adjusted(poses, points);
  CHECK(worst_difference(poses, scene.poses) < 1e-5);
  CHECK(worst_difference(points, scene.points) < 1e-4);
  for (std::size_t n = 0; n < kCorners; ++n) {
    for (std::size_t i = 0; i < 3; ++i) CHECK(n == 0 ? information[4 * i] == 0.0 : information[9 * n + 4 * i] > 0.0);
  }

  // More keyframes, and corners that none but the first observes: nothing moves them, nor the keyframes.
  std::vector<double> many, lone_rays(kCorners * 28, kNaN), lone_depth(kCorners * 14, kNaN), of_lone(9 * kCorners);
  for (std::size_t w = 0; w < 14; ++w) many.insert(many.end(), scene.poses.begin(), scene.poses.begin() + 16);
  for (std::size_t n = 0; n < kCorners; ++n) {
    for (std::size_t i = 0; i < 2; ++i) lone_rays[28 * n + i] = scene.points[3 * n + i] / scene.points[3 * n + 2];
    lone_depth[14 * n] = std::log(scene.points[3 * n + 2]);
  }
  const std::vector<double> before = many;
  points = scene.points;
  monoloc::adjust_window({lone_rays.data(), lone_depth.data(), kCorners, 14, 0.002, 0.1}, 2, many.data(), points.data(),
                         of_lone.data());
  CHECK(worst_difference(many, before) < 1e-12);
  CHECK(worst_difference(points, scene.points) < 1e-9);

  // Nothing to adjust: no keyframes, one, or no corners.
  monoloc::adjust_window({nullptr, nullptr, 0, 0, 0.002, 0.1}, 3, nullptr, nullptr, nullptr);
  std::vector<double> kept = scene.poses;
  monoloc::adjust_window({nullptr, nullptr, 0, kFrames, 0.002, 0.1}, 3, kept.data(), nullptr, nullptr);
  CHECK(worst_difference(kept, scene.poses) == 0.0);
  const double ray[2] = {0.1, 0.2}, log_depth = 0.0;
  double point[3] = {0.0, 0.0, 1.0}, of_point[9];
  monoloc::adjust_window({ray, &log_depth, 1, 1, 0.002, 0.1}, 5, kept.data(), point, of_point);
  CHECK(std::abs(point[0] - 0.1) < 1e-3 && std::abs(point[1] - 0.2) < 1e-3 && std::abs(point[2] - 1.0) < 1e-3);
}

// Against plain loops.
void test_gram(const monoloc::Kernels& kernels) {
  const std::size_t count = 5, columns = 35, stride = 3 * monoloc::kPadding;
  std::vector<double> rows(count * stride), out(stride * stride, 0.5);
  for (std::size_t i = 0; i < rows.size(); ++i) rows[i] = std::sin(static_cast<double>(i));
  kernels.add_gram(rows.data(), count, columns, stride, out.data());
  double worst = 0.0;
  for (std::size_t i = 0; i < columns; ++i) {
    for (std::size_t j = i; j < columns; ++j) {
      double sum = 0.5;
      for (std::size_t k = 0; k < count; ++k) sum += rows[k * stride + i] * rows[k * stride + j];
      worst = std::max(worst, std::abs(out[i * stride + j] - sum));
    }
  }
  CHECK(worst < 1e-14);
}
