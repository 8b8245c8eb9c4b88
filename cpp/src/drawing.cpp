#include "monoloc/drawing.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <vector>

namespace monoloc {
namespace {

constexpr std::uint64_t kNothing = ~std::uint64_t{0};

// Key of a point: bits of its depth (positive floats are in the order of their bits), then its index.
std::uint64_t to_key(float depth, std::uint32_t number) {
  std::uint32_t bits;
  std::memcpy(&bits, &depth, sizeof bits);
  return (static_cast<std::uint64_t>(bits) << 32) | number;
}

float depth_of(std::uint64_t key) {
  const auto bits = static_cast<std::uint32_t>(key >> 32);
  float depth;
  std::memcpy(&depth, &bits, sizeof depth);
  return depth;
}

// A visible point: the first of its four pixels, in an image with a margin of one pixel on each side, its index, and
// its depth.
struct Seen {
  std::uint32_t corner, number;
  float depth;
};

struct Point {
  double x, y;
};

// Image coordinates, in focal lengths, of a point at a depth of one.
Point distorted(const Lens& camera, double x, double y, double r2) {
  const double* k = camera.coefficients;
  if (camera.is_fisheye) {
    const double r = std::sqrt(std::max(r2, 1e-18)), angle = std::atan(r), a2 = angle * angle;
    const double radial = angle / r * (1.0 + a2 * (k[0] + a2 * (k[1] + a2 * (k[2] + a2 * k[3]))));
    return {x * radial, y * radial};
  }
  const double above = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4])), below = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]));
  const double radial = above / below, p1 = k[2], p2 = k[3];
  return {x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
          y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y};
}

std::vector<Seen> project(const double* points, std::size_t count, const double* camera_from_world, const Lens& camera,
                          const Sight& sight, std::size_t rows, std::size_t columns) {
  const double* m = camera_from_world;  // (4, 4), row-major
  const auto most_u = static_cast<double>(columns), most_v = static_cast<double>(rows);
  const double most_r2 = sight.most_radius * sight.most_radius;
  std::vector<Seen> seen;
  seen.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    const double* p = points + 3 * i;
    const double z = m[8] * p[0] + m[9] * p[1] + m[10] * p[2] + m[11];
    if (!(z > sight.least_depth)) continue;
    const double x = (m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3]) / z;
    const double y = (m[4] * p[0] + m[5] * p[1] + m[6] * p[2] + m[7]) / z;
    if (!(std::abs(x) < sight.most_x && std::abs(y) < sight.most_y)) continue;
    const double r2 = x * x + y * y;
    if (!(r2 < most_r2)) continue;
    const Point bent = distorted(camera, x, y, r2);
    const double u = std::floor(bent.x * camera.fx + camera.cx), v = std::floor(bent.y * camera.fy + camera.cy);
    if (!(u >= -1.0 && v >= -1.0 && u < most_u && v < most_v)) continue;
    const std::size_t corner = static_cast<std::size_t>(v + 1.0) * (columns + 2) + static_cast<std::size_t>(u + 1.0);
    seen.push_back({static_cast<std::uint32_t>(corner), static_cast<std::uint32_t>(i), static_cast<float>(z)});
  }
  return seen;
}

}  // namespace

void draw_points(const double* points, std::size_t count, const double* camera_from_world, const Lens& camera,
                 const Sight& sight, double behind, std::size_t rows, std::size_t columns, std::uint32_t* front,
                 float* depth) {
  const std::size_t stride = columns + 2, size = (rows + 2) * stride;
  const std::array<std::size_t, 4> covered{0, 1, stride, stride + 1};
  const std::vector<Seen> seen = project(points, count, camera_from_world, camera, sight, rows, columns);

  std::vector<std::uint64_t> nearest(size, kNothing);
  for (const Seen& point : seen) {
    const std::uint64_t key = to_key(point.depth, point.number);
    for (const std::size_t step : covered) nearest[point.corner + step] = std::min(nearest[point.corner + step], key);
  }

  struct Sum {
    float farthest, total, number;
  };
  std::vector<Sum> sums(size, Sum{0.0f, 0.0f, 0.0f});
  const auto reach = static_cast<float>(1.0 + behind);
  for (std::size_t pixel = 0; pixel < size; ++pixel) {
    if (nearest[pixel] != kNothing) sums[pixel].farthest = reach * depth_of(nearest[pixel]);
  }
  for (const Seen& point : seen) {
    for (const std::size_t step : covered) {
      Sum& sum = sums[point.corner + step];
      const float counts = point.depth <= sum.farthest ? 1.0f : 0.0f;
      sum.total += counts * point.depth;
      sum.number += counts;
    }
  }

  for (std::size_t row = 0; row < rows; ++row) {
    for (std::size_t column = 0; column < columns; ++column) {
      const std::size_t pixel = (row + 1) * stride + column + 1, out = row * columns + column;
      front[out] = static_cast<std::uint32_t>(nearest[pixel]);  // kNothing becomes kNoPoint
      depth[out] = sums[pixel].number > 0.0f ? sums[pixel].total / sums[pixel].number : 0.0f;
    }
  }
}

}  // namespace monoloc
