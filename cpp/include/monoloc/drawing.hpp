// Points of a room drawn as a camera sees them: of those that cover a pixel, the nearest is seen.
#pragma once

#include <cstddef>
#include <cstdint>

namespace monoloc {

// Brown's model, as in OpenCV; pixel (0, 0) is the centre of the first.
struct Pinhole {
  double fx, fy, cx, cy;
  double k1, k2, p1, p2, k3;
};

// Points are drawn that lie farther before the camera than this, and less far aside at a depth of one: distortion is a
// polynomial, which folds what lies far aside back into the image.
struct Sight {
  double least_depth, most_x, most_y;
};

constexpr std::uint64_t kNothing = ~std::uint64_t{0};

// Draws points, each on the four pixels about it, into an image of keys with a margin of one pixel on every side. A
// key is the depth's bits as a float, and below them the point's number, `first` for the first: the least key is the
// nearest point's, and of several as near the first's. `nearest`, (rows + 2) * (columns + 2), begins as kNothing.
void draw_nearest(const double* points, std::size_t count, const double* camera_from_world, const Pinhole& camera,
                  const Sight& sight, std::uint32_t first, std::size_t rows, std::size_t columns,
                  std::uint64_t* nearest);

}  // namespace monoloc
