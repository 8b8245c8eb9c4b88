// Bundle adjustment of a few keyframes.
#pragma once

#include <cstddef>
#include <vector>

namespace monoloc {

// W keyframes that observe N corners, in a common frame r. An observation that is not finite is missing.
struct Observations {
  const double* rays;       // (N, W, 2) image coordinates at z = 1
  const double* log_depth;  // (N, W) logarithm of predicted depth
  std::size_t corners, frames;
  double ray_sd, log_depth_sd;  // standard deviations
};

// Poses and points that maximise the likelihood of the observations, by Gauss-Newton steps with Huber's weights. The
// formulas: monoloc.odometry.window_numpy_twin.
//   poses (W, 4, 4) T_r_camera, of which the first is fixed, and points (N, 3): initial values, which are replaced;
//   information (N, 3, 3): receives the inverse covariance of each point from its rays, given the poses.
// Throws std::domain_error if a step's normal matrix is singular.
void adjust_window(const Observations& observations, std::size_t iterations, double* poses, double* points,
                   double* information);

}  // namespace monoloc
