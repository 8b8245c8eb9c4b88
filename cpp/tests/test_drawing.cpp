// Rendering of points: images of the nearest point's index and of its surface's depth.
#include <cmath>
#include <cstdint>
#include <vector>

#include "check.hpp"
#include "monoloc/drawing.hpp"
#include "tests.hpp"

namespace {

constexpr std::size_t kRows = 3, kColumns = 4;
constexpr double kIdentity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
constexpr monoloc::Lens kCamera{1, 1, 0, 0, {}, false};  // at a depth of one, metres are pixels
constexpr monoloc::Sight kSight{0.1, 10.0, 10.0, 14.0};
constexpr double kBehind = 0.25;

struct Image {
  std::vector<std::uint32_t> front = std::vector<std::uint32_t>(kRows * kColumns);
  std::vector<float> depth = std::vector<float>(kRows * kColumns);
};

Image drawn(const std::vector<double>& points, const double* pose = kIdentity,
            const monoloc::Lens& camera = kCamera) {
  Image image;
  monoloc::draw_points(points.data(), points.size() / 3, pose, camera, kSight, kBehind, kRows, kColumns,
                       image.front.data(), image.depth.data());
  return image;
}

std::size_t at(std::size_t row, std::size_t column) { return row * kColumns + column; }

std::size_t count_drawn(const Image& image) {
  std::size_t count = 0;
  for (std::size_t pixel = 0; pixel < image.front.size(); ++pixel) {
    const bool is_drawn = image.front[pixel] != monoloc::kNoPoint;
    CHECK(is_drawn == (image.depth[pixel] > 0.0f));
    count += is_drawn;
  }
  return count;
}

bool is_near(float a, double b) { return std::abs(a - b) < 1e-6; }

}  // namespace

void test_drawing() {
  // A point between four pixels covers exactly these.
  const Image one = drawn({1.5, 0.5, 1.0});
  CHECK(count_drawn(one) == 4);
  for (const std::size_t pixel : {at(0, 1), at(0, 2), at(1, 1), at(1, 2)}) {
    CHECK(one.front[pixel] == 0 && one.depth[pixel] == 1.0f);
  }

  // The nearest point is visible in any order; of two at the same depth, the first.
  const Image several = drawn({3.0, 1.0, 2.0, 1.5, 0.5, 1.0, 1.5, 0.5, 1.0, 6.0, 2.0, 4.0});
  CHECK(several.front[at(0, 1)] == 1);

  // The depth is the mean over points of the same surface; points behind it are excluded.
  const Image surface = drawn({1.8, 0.6, 1.2, 1.5, 0.5, 1.0, 1.95, 0.65, 1.3});
  CHECK(surface.front[at(0, 1)] == 1);
  CHECK(is_near(surface.depth[at(0, 1)], 1.1));

  // Points behind the camera, too near, or outside are not drawn; a point next to the image covers its border.
  CHECK(count_drawn(drawn({1.5, 0.5, -1.0, 0.15, 0.05, 0.1, 4.0, 0.5, 1.0, 1.5, -1.5, 1.0})) == 0);
  CHECK(drawn({-0.5, 1.0, 1.0}).front[at(1, 0)] == 0);

  // With a pose, and with distortion: k1 = 1 doubles the distance from the centre at r = 1.
  const double pose[16] = {0, -1, 0, 1, 1, 0, 0, 0, 0, 0, 1, -1, 0, 0, 0, 1};
  CHECK(drawn({0.25, -0.5, 2.0}, pose).front[at(0, 1)] == 0);
  const monoloc::Lens bent{1, 1, 0, 0, {1}, false};
  CHECK(drawn({1.0, 0.0, 1.0}, kIdentity, bent).front[at(0, 2)] == 0);
  // k4 = -0.5 does, too.
  const monoloc::Lens rational{1, 1, 0, 0, {0, 0, 0, 0, 0, -0.5}, false};
  CHECK(drawn({1.0, 0.0, 1.0}, kIdentity, rational).front[at(0, 2)] == 0);
  // A fisheye shows 45 degrees at a distance of pi / 4; beyond the field of view, nothing.
  const monoloc::Lens fisheye{4, 4, 0, 0, {}, true};
  CHECK(drawn({1.0, 0.0, 1.0}, kIdentity, fisheye).front[at(0, 3)] == 0);
  CHECK(count_drawn(drawn({9.99, 9.99, 1.0}, kIdentity, {0.5, 0.5, 0, 0, {}, true})) == 0);
}
