// Roots of quartics, and poses of landmarks that most matches agree with.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "check.hpp"
#include "monoloc/landmark_consensus.hpp"
#include "tests.hpp"

namespace {

void test_roots() {
  // (x - 1) (x + 2) (x - 3) (x - 0.5), and two real roots: (x^2 + 1) (x - 1) (x - 2).
  double roots[4];
  const double four[5] = {-3.0, 8.5, -4.0, -2.5, 1.0};
  CHECK(monoloc::real_roots(four, roots) == 4);
  std::sort(roots, roots + 4);
  const double expected[4] = {-2.0, 0.5, 1.0, 3.0};
  for (int i = 0; i < 4; ++i) CHECK(std::abs(roots[i] - expected[i]) < 1e-9);
  const double two[5] = {2.0, -3.0, 3.0, -3.0, 1.0};
  CHECK(monoloc::real_roots(two, roots) == 2);
  CHECK(std::abs(roots[0] + roots[1] - 3.0) < 1e-9 && std::abs(roots[0] * roots[1] - 2.0) < 1e-9);
  // Without a linear term, or nearly so: x^4 - 1, (x^2 + 4) (x^2 - 1), and x^4 + 1e-8 x - 1, around zero and around 3.
  const double even[3][3] = {{0.0, 0.0, -1.0}, {3.0, 0.0, -4.0}, {0.0, 1e-8, -1.0}};
  for (const auto& [square, linear, constant] : even) {
    for (const double at : {0.0, 3.0}) {
      const double around[5] = {at * at * (at * at + square) - linear * at + constant,
                                -2.0 * at * (2.0 * at * at + square) + linear, 6.0 * at * at + square, -4.0 * at, 1.0};
      CHECK(monoloc::real_roots(around, roots) == 2);
      for (const double side : {-1.0, 1.0}) {
        const double root = at + side - linear / (4.0 + 2.0 * square);
        CHECK(std::abs(roots[side > 0.0] - root) < 1e-13);
      }
    }
  }
  const double none[5] = {1.0, 0.0, 2.0, 0.0, 1.0};  // (x^2 + 1)^2
  CHECK(monoloc::real_roots(none, roots) == 0);
  const double not_finite[5] = {1.0, 0.0, NAN, 0.0, 1.0};
  CHECK(monoloc::real_roots(not_finite, roots) == 0);
}

// A camera at the origin sees 80 points, all but `right` of them where they are not.
void test_share(std::size_t right) {
  constexpr std::size_t kCount = 80;
  std::vector<double> points, rays, sd(2 * kCount, 0.002);
  for (std::size_t i = 0; i < kCount; ++i) {
    const double n = static_cast<double>(i), z = 2.0 + std::sin(1.7 * n);
    const double x = 0.6 * std::sin(0.9 * n), y = 0.4 * std::cos(2.3 * n);
    points.insert(points.end(), {x * z, y * z, z});
    const bool is_right = i * 37 % kCount < right;
    rays.insert(rays.end(), {is_right ? x : 0.7 * std::sin(5.1 * n), is_right ? y : 0.5 * std::cos(7.7 * n)});
  }
  const auto found = monoloc::find_consensus({points.data(), rays.data(), sd.data(), kCount, 0.05}, 4.0, 1000, 0.999);
  CHECK(found.agreeing.size() >= right);
  std::size_t agreeing = 0;
  for (const std::uint32_t n : found.agreeing) agreeing += n * 37 % kCount < right;
  CHECK(agreeing == right);
  for (std::size_t i = 0; i < 16; ++i) CHECK(std::abs(found.pose[i] - (i % 5 == 0 ? 1.0 : 0.0)) < 1e-4);
}

}  // namespace

void test_landmark_consensus() {
  test_roots();
  for (const std::size_t right : {80, 40, 20}) test_share(right);
  const double points[6] = {0, 0, 1, 1, 0, 1}, rays[4] = {0, 0, 1, 0}, sd[4] = {1, 1, 1, 1};
  CHECK(monoloc::find_consensus({points, rays, sd, 2, 0.05}, 4.0, 10, 0.999).agreeing.empty());
}
