#include "monoloc/drawing.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace monoloc {
namespace {

// Positive floats are ordered as their bits are.
std::uint64_t to_key(double depth, std::uint32_t number) {
  const auto single = static_cast<float>(depth);
  std::uint32_t bits;
  std::memcpy(&bits, &single, sizeof bits);
  return (static_cast<std::uint64_t>(bits) << 32) | number;
}

}  // namespace

void draw_nearest(const double* points, std::size_t count, const double* camera_from_world, const Pinhole& camera,
                  const Sight& sight, std::uint32_t first, std::size_t rows, std::size_t columns,
                  std::uint64_t* nearest) {
  const double* m = camera_from_world;  // (4, 4), row by row
  const auto most_u = static_cast<double>(columns), most_v = static_cast<double>(rows);
  const std::size_t stride = columns + 2;
  for (std::size_t i = 0; i < count; ++i) {
    const double* p = points + 3 * i;
    const double z = m[8] * p[0] + m[9] * p[1] + m[10] * p[2] + m[11];
    if (!(z > sight.least_depth)) continue;
    const double x = (m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3]) / z;
    const double y = (m[4] * p[0] + m[5] * p[1] + m[6] * p[2] + m[7]) / z;
    if (!(std::abs(x) < sight.most_x && std::abs(y) < sight.most_y)) continue;
    const double r2 = x * x + y * y;
    const double radial = 1.0 + r2 * (camera.k1 + r2 * (camera.k2 + r2 * camera.k3));
    const double bent_x = x * radial + 2.0 * camera.p1 * x * y + camera.p2 * (r2 + 2.0 * x * x);
    const double bent_y = y * radial + camera.p1 * (r2 + 2.0 * y * y) + 2.0 * camera.p2 * x * y;
    const double u = std::floor(bent_x * camera.fx + camera.cx), v = std::floor(bent_y * camera.fy + camera.cy);
    if (!(u >= -1.0 && v >= -1.0 && u < most_u && v < most_v)) continue;
    const std::uint64_t key = to_key(z, first + static_cast<std::uint32_t>(i));
    std::uint64_t* corner = nearest + static_cast<std::size_t>(v + 1.0) * stride + static_cast<std::size_t>(u + 1.0);
    for (std::uint64_t* pixel : {corner, corner + 1, corner + stride, corner + stride + 1}) {
      *pixel = std::min(*pixel, key);
    }
  }
}

}  // namespace monoloc
