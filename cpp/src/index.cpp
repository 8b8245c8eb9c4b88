#include "monoloc/index.hpp"

#include <cmath>

#include "padded.hpp"

namespace monoloc {

IndexView MixtureIndex::view() const {
  IndexView view{};
  for (int axis = 0; axis < 3; ++axis) {
    view.origin[axis] = origin_[axis];
    view.bricks[axis] = bricks_[axis];
  }
  view.voxels_per_m = static_cast<float>(1.0 / voxel_m_);
  view.hash_shift = hash_shift_;
  view.slot_mask = static_cast<std::uint32_t>(slots_.size() - 1);
  view.slots = slots_.data();
  view.lists = voxel_lists_.data();
  view.blocks = blocks_.data();
  return view;
}

void MixtureIndex::log_density(const double* points, std::size_t count, double* out) const {
  if (count == 0) return;
  const std::size_t stride = padded(count);
  const std::vector<float> rows = padded_rows<float>(points, count, centre_);
  std::vector<float> density(stride);
  kernels().density(view(), rows.data(), stride, density.data());
  for (std::size_t i = 0; i < count; ++i) out[i] = std::log(static_cast<double>(density[i]));
}

std::size_t MixtureIndex::evaluations(const double* points, std::size_t count) const {
  if (count == 0) return 0;
  const std::size_t stride = padded(count);
  const std::vector<float> rows = padded_rows<float>(points, count, centre_);
  std::vector<float> density(stride);
  return kernels().density(view(), rows.data(), stride, density.data()) * kBlockLanes;
}

void MixtureIndex::weigh(const double* poses, const double* log_scales, std::size_t particles, const float* scan,
                         const float* point_weights, std::size_t points, double outlier_share, double volume_m3,
                         double* out) const {
  if (particles == 0) return;
  const std::size_t stride = padded(particles);
  std::vector<float> rows(12 * stride), scan_rows(3 * points);
  for (std::size_t n = 0; n < stride; ++n) {
    const std::size_t source = n < particles ? n : particles - 1;
    const double* T = poses + 16 * source;
    const double scale = std::exp(log_scales[source]);
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) rows[(3 * i + j) * stride + n] = static_cast<float>(scale * T[4 * i + j]);
      rows[(9 + i) * stride + n] = static_cast<float>(T[4 * i + 3] - centre_[i]);
    }
  }
  for (std::size_t p = 0; p < points; ++p) {
    for (int axis = 0; axis < 3; ++axis) scan_rows[axis * points + p] = scan[3 * p + axis];
  }
  std::vector<double> result(stride);
  const auto inlier_share = static_cast<float>(1.0 - outlier_share);
  const auto outlier_density = static_cast<float>(outlier_share / volume_m3);
  kernels().weigh(view(), rows.data(), stride, scan_rows.data(), point_weights, points, inlier_share, outlier_density,
                  result.data());
  for (std::size_t n = 0; n < particles; ++n) out[n] = result[n];
}

}  // namespace monoloc
