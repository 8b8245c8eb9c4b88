// Renders points of a room into a camera image with a z-buffer.
#pragma once

#include <cstddef>
#include <cstdint>

namespace monoloc {

// Camera with one of OpenCV's distortion models; (0, 0) is the centre of the first pixel. The coefficients are k1, k2,
// p1, p2, k3, k4, k5, k6 of the rational model, of which the last three are 0 for Brown's, or k1 to k4 of a fisheye.
struct Lens {
  double fx, fy, cx, cy;
  double coefficients[8];
  bool is_fisheye;
};

// Bounds of the field of view: minimum depth, and maximum |x|, |y| and sqrt(x^2 + y^2) at a depth of one. Points outside
// are not drawn, because the distortion polynomial would fold them back into the image.
struct Sight {
  double least_depth, most_x, most_y, most_radius;
};

constexpr std::uint32_t kNoPoint = ~std::uint32_t{0};

// Draws each point on the four pixels around it, into images of (rows, columns) pixels. `front`: index of the nearest
// point on the pixel (the first of several at the same depth), or kNoPoint. `depth`: mean depth of the points within
// the share `behind` of the nearest depth, which belong to one surface, or 0. The nearest depth alone would be biased
// for noisy points and for slanted surfaces. The numbers of points and pixels are below 2^32.
void draw_points(const double* points, std::size_t count, const double* camera_from_world, const Lens& camera,
                 const Sight& sight, double behind, std::size_t rows, std::size_t columns, std::uint32_t* front,
                 float* depth);

}  // namespace monoloc
