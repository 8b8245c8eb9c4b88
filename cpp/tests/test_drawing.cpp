// Points drawn into an image of keys.
#include <cstdint>
#include <cstring>
#include <vector>

#include "check.hpp"
#include "monoloc/drawing.hpp"
#include "tests.hpp"

namespace {

constexpr std::size_t kRows = 3, kColumns = 4, kStride = kColumns + 2;
constexpr double kIdentity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
constexpr monoloc::Pinhole kCamera{1, 1, 0, 0, 0, 0, 0, 0, 0};  // at a depth of one, metres are pixels
constexpr monoloc::Sight kSight{0.1, 10.0, 10.0};

std::vector<std::uint64_t> drawn(const std::vector<double>& points, const double* pose = kIdentity,
                                 const monoloc::Pinhole& camera = kCamera) {
  std::vector<std::uint64_t> keys((kRows + 2) * kStride, monoloc::kNothing);
  monoloc::draw_nearest(points.data(), points.size() / 3, pose, camera, kSight, 5, kRows, kColumns, keys.data());
  return keys;
}

float depth_of(std::uint64_t key) {
  const auto bits = static_cast<std::uint32_t>(key >> 32);
  float depth;
  std::memcpy(&depth, &bits, sizeof depth);
  return depth;
}

std::size_t at(std::size_t row, std::size_t column) { return (row + 1) * kStride + column + 1; }

std::size_t count_drawn(const std::vector<std::uint64_t>& keys) {
  std::size_t count = 0;
  for (const std::uint64_t key : keys) count += key != monoloc::kNothing;
  return count;
}

}  // namespace

void test_drawing() {
  // A point between four pixels is on each of them, and on no other.
  const auto one = drawn({1.5, 0.5, 1.0});
  CHECK(count_drawn(one) == 4);
  for (const std::size_t pixel : {at(0, 1), at(0, 2), at(1, 1), at(1, 2)}) {
    CHECK(depth_of(one[pixel]) == 1.0f && static_cast<std::uint32_t>(one[pixel]) == 5);
  }

  // The nearest is seen, whatever comes first; of two as near, the first.
  const auto several = drawn({3.0, 1.0, 2.0, 1.5, 0.5, 1.0, 1.5, 0.5, 1.0, 6.0, 2.0, 4.0});
  CHECK(static_cast<std::uint32_t>(several[at(0, 1)]) == 6);

  // Neither behind, nor too near, nor outside is anything drawn; beside the image its edge is.
  CHECK(count_drawn(drawn({1.5, 0.5, -1.0, 0.15, 0.05, 0.1, 4.0, 0.5, 1.0, 1.5, -1.5, 1.0})) == 0);
  CHECK(drawn({-0.5, 1.0, 1.0})[at(1, 0)] != monoloc::kNothing);

  // Moved by a pose, and bent: at r = 1 a k1 of one doubles the distance from the middle.
  const double pose[16] = {0, -1, 0, 1, 1, 0, 0, 0, 0, 0, 1, -1, 0, 0, 0, 1};
  CHECK(static_cast<std::uint32_t>(drawn({0.25, -0.5, 2.0}, pose)[at(0, 1)]) == 5);
  const monoloc::Pinhole bent{1, 1, 0, 0, 1, 0, 0, 0, 0};
  CHECK(drawn({1.0, 0.0, 1.0}, kIdentity, bent)[at(0, 2)] != monoloc::kNothing);
}
