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

constexpr std::uint32_t kNoPoint = ~std::uint32_t{0};

// Draws points, each on the four pixels about it, into images of (rows, columns) pixels. `front` takes the number of the
// nearest of those that cover a pixel, of several as near the first's, or kNoPoint; `depth` the mean depth of those that
// lie no farther behind the nearest than the share `behind` of its depth, or 0: they are of one surface, and the nearest
// of many that err, or of a slanted surface, is too near. There are fewer than 2^32 points and pixels.
void draw_points(const double* points, std::size_t count, const double* camera_from_world, const Pinhole& camera,
                 const Sight& sight, double behind, std::size_t rows, std::size_t columns, std::uint32_t* front,
                 float* depth);

}  // namespace monoloc
