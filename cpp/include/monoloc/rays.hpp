// Density of depth along rays through a mixture, from the pose of each particle.
#pragma once

#include <cstddef>
#include <vector>

#include "monoloc/mixture.hpp"

namespace monoloc {

// Noise model of depth along a ray.
struct RayNoise {
  double log_depth_sd;     // standard deviation of an inlier's log-depth
  double outlier_share;    // eps
  double log_depth_range;  // support of outliers, which are uniform in log-depth
};

struct Rows;

class RayMixture {
 public:
  explicit RayMixture(const std::vector<Component>& mixture);

  // For each particle: sum_p w_p log p(log d_p | ray), see monoloc.map.numpy_twins.weigh_rays.
  //   poses (N, 4, 4) T_world_camera; log_scales (N); scan (P, 3) in the camera's frame, z > 0; point_weights (P), or
  //   nullptr for ones.
  void weigh(const double* poses, const double* log_scales, std::size_t particles, const float* scan,
             const float* point_weights, std::size_t points, const RayNoise& noise, double* out) const;

 private:
  // A cube with components, which are those from first up to last.
  struct Cell {
    double centre[3];
    std::size_t first, last;
  };

  // Components within `reach` metres of a centre, relative to it.
  Rows within(const double* centre, double reach) const;

  std::vector<Component> mixture_;  // cell by cell
  std::vector<Cell> cells_;
};

}  // namespace monoloc
