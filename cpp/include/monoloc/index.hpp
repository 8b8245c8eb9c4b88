// Spatial index of a mixture: each voxel near the map stores the few components that matter in it. A hash table
// stores bricks of 4 x 4 x 4 voxels, so that memory grows with the map's surface.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

#include "monoloc/kernels.hpp"
#include "monoloc/mixture.hpp"

namespace monoloc {

struct IndexSettings {
  double voxel_m;         // edge of a voxel
  double floor_density;   // smallest outlier density in use, 1/m^3
  double tolerance;       // allowed relative error of (density + floor) in a voxel
  std::size_t threads = 1;  // that build it; their number does not affect the result
  std::function<void()> pause = [] {};  // called now and then; what it throws ends the construction
};

class MixtureIndex {
 public:
  // Throws std::invalid_argument if the grid would need more than 2^32 bricks.
  MixtureIndex(const std::vector<Component>& mixture, const IndexSettings& settings);

  // Natural logarithm of the density at points (P, 3); -infinity outside the indexed voxels.
  void log_density(const double* points, std::size_t count, double* out) const;

  // Number of components that log_density(points) evaluates, including free lanes of blocks.
  std::size_t evaluations(const double* points, std::size_t count) const;

  // For each particle: sum_p w_p log((1 - eps) M(T e^s x_p) + eps / V).
  //   poses (N, 4, 4) T_world_camera; log_scales (N); scan (P, 3) in the camera's frame;
  //   point_weights (P), or nullptr for ones.
  void weigh(const double* poses, const double* log_scales, std::size_t particles, const float* scan,
             const float* point_weights, std::size_t points, double outlier_share, double volume_m3,
             double* out) const;

  double voxel_m() const { return voxel_m_; }
  std::size_t voxels() const { return voxels_; }
  std::size_t lists() const { return lists_; }
  double mean_candidates() const { return mean_candidates_; }
  std::size_t bytes() const {
    return slots_.size() * sizeof(Slot) + voxel_lists_.size() * sizeof(std::uint32_t) +
           blocks_.size() * sizeof(float);
  }

  // Input of the kernels; valid during the lifetime of the index.
  IndexView view() const;

 private:
  double voxel_m_;
  double centre_[3];  // subtracted from all coordinates, so that single precision suffices
  float origin_[3];   // lower corner of the grid, relative to centre_
  std::int32_t bricks_[3];
  std::uint32_t hash_shift_;
  std::vector<Slot> slots_;
  std::vector<std::uint32_t> voxel_lists_;
  std::vector<float> blocks_;
  std::size_t voxels_ = 0;
  std::size_t lists_ = 0;
  double mean_candidates_ = 0.0;
};

}  // namespace monoloc
