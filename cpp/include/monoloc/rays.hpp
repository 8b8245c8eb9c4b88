// A mixture seen along rays: how likely a depth is on its ray, from where each particle stands.
#pragma once

#include <cstddef>
#include <vector>

#include "monoloc/mixture.hpp"

namespace monoloc {

// How depths spread about the map, and what else they may be.
struct RayNoise {
  double log_depth_sd;     // of an inlier's log-depth about the surface
  double outlier_share;    // eps
  double log_depth_range;  // outliers are uniform over so much log-depth
};

class RayMixture {
 public:
  explicit RayMixture(const std::vector<Component>& mixture);

  // For every particle: sum_p w_p log p(log d_p | ray), see monoloc.map.numpy_twins.weigh_rays.
  //   poses (N, 4, 4) T_world_camera; log_scales (N); scan (P, 3) in the camera's frame, z > 0; point_weights (P), or
  //   nullptr for ones; threads: share the particles, the result is the same for any number.
  void weigh(const double* poses, const double* log_scales, std::size_t particles, const float* scan,
             const float* point_weights, std::size_t points, const RayNoise& noise, std::size_t threads,
             double* out) const;

 private:
  std::vector<Component> mixture_;
};

}  // namespace monoloc
