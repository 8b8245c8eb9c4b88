#include "monoloc/rays.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "padded.hpp"
#include "ray_selection.hpp"

namespace monoloc {
namespace {

constexpr double kReach_m = 12.0;  // components farther from all particles are ignored
constexpr double kCell_m = 4.0;
constexpr double kTypicalDepth_m = 2.0;
constexpr double kNarrow_m = 0.6;  // particles within this reach share one selection of components
constexpr std::size_t kFew = 32;   // particles at which the shared selection is made

// Mean of the particles' centres, and the spread of centres and of visible points.
struct Spread {
  double centre[3];
  double radius;  // largest distance of a centre from the mean
  double reach;   // largest displacement of a point at kTypicalDepth_m
};

Spread spread_of(const double* poses, std::size_t particles) {
  double mean[12] = {};
  for (std::size_t n = 0; n < particles; ++n) {
    for (int i = 0; i < 12; ++i) mean[i] += poses[16 * n + i] / static_cast<double>(particles);
  }
  Spread spread{{mean[3], mean[7], mean[11]}, 0.0, 0.0};
  for (std::size_t n = 0; n < particles; ++n) {
    double moved = 0.0, turned = 0.0;
    for (int i = 0; i < 12; ++i) (i % 4 == 3 ? moved : turned) += std::pow(poses[16 * n + i] - mean[i], 2);
    spread.radius = std::max(spread.radius, std::sqrt(moved));
    spread.reach = std::max(spread.reach, std::sqrt(moved) + kTypicalDepth_m * std::sqrt(turned / 2.0));
  }
  return spread;
}

double squared_distance(const double* a, const double* b) {
  double squared = 0.0;
  for (int axis = 0; axis < 3; ++axis) squared += (a[axis] - b[axis]) * (a[axis] - b[axis]);
  return squared;
}

// 13 rows of `stride` floats (rotation row-major, scale, centre) of particles first, first + step, ...
std::vector<float> particle_rows(const double* poses, const double* log_scales, std::size_t particles,
                                 const double* centre, std::size_t first, std::size_t step, std::size_t stride) {
  std::vector<float> rows(13 * stride);
  for (std::size_t i = 0; i < stride; ++i) {
    const std::size_t n = std::min(first + i * step, particles - 1);
    const double* T = poses + 16 * n;
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < 3; ++column) {
        rows[(3 * row + column) * stride + i] = static_cast<float>(T[4 * row + column]);
      }
      rows[(10 + row) * stride + i] = static_cast<float>(T[4 * row + 3] - centre[row]);
    }
    rows[9 * stride + i] = static_cast<float>(std::exp(log_scales[n]));
  }
  return rows;
}

}  // namespace

RayMixture::RayMixture(const std::vector<Component>& mixture) : mixture_(mixture) {
  const auto cell_of = [](const Component& c) {
    return std::array{std::floor(c.mean[0] / kCell_m), std::floor(c.mean[1] / kCell_m), std::floor(c.mean[2] / kCell_m)};
  };
  std::stable_sort(mixture_.begin(), mixture_.end(),
                   [&](const Component& a, const Component& b) { return cell_of(a) < cell_of(b); });
  for (std::size_t k = 0; k < mixture_.size(); ++k) {
    const auto cell = cell_of(mixture_[k]);
    if (k == 0 || cell != cell_of(mixture_[k - 1])) {
      cells_.push_back({{(cell[0] + 0.5) * kCell_m, (cell[1] + 0.5) * kCell_m, (cell[2] + 0.5) * kCell_m}, k, k});
    }
    cells_.back().last = k + 1;
  }
}

Rows RayMixture::within(const double* centre, double reach) const {
  Rows rows;
  const double cell_reach = reach + 0.5 * std::sqrt(3.0) * kCell_m;
  for (const Cell& cell : cells_) {
    if (squared_distance(cell.centre, centre) > cell_reach * cell_reach) continue;
    for (std::size_t k = cell.first; k < cell.last; ++k) {
      const Component& component = mixture_[k];
      if (squared_distance(component.mean, centre) > reach * reach || !std::isfinite(component.log2_peak)) continue;
      for (int i = 0; i < 6; ++i) rows.whiten.push_back(static_cast<float>(component.whiten[i]));
      for (int i = 0; i < 3; ++i) rows.means.push_back(static_cast<float>(component.mean[i] - centre[i]));
      rows.log2_peak.push_back(static_cast<float>(component.log2_peak));
    }
  }
  return rows;
}

void RayMixture::weigh(const double* poses, const double* log_scales, std::size_t particles, const float* scan,
                       const float* point_weights, std::size_t points, const RayNoise& noise,
                       double* out) const {
  if (particles == 0) return;
  const Spread spread = spread_of(poses, particles);
  Rows rows = within(spread.centre, kReach_m + spread.radius);

  const std::vector<std::size_t> order = by_tile(scan, points);
  std::vector<float> scan_rows(3 * points), weights(points, 1.0f);  // x / z, y / z, z
  for (std::size_t p = 0; p < points; ++p) {
    const float* point = scan + 3 * order[p];
    scan_rows[p] = point[0] / point[2];
    scan_rows[points + p] = point[1] / point[2];
    scan_rows[2 * points + p] = point[2];
    if (point_weights) weights[p] = point_weights[order[p]];
  }

  const bool alike = spread.reach < kNarrow_m;
  Candidates shared;
  if (alike) {
    const std::size_t count = std::min(kFew, padded(particles)), step = (particles + count - 1) / count;
    const std::vector<float> few = particle_rows(poses, log_scales, particles, spread.centre, 0, step, count);
    shared = shared_candidates(rows, few, count, scan_rows, points);
  }
  const RayView view = rows.view();
  const auto sd = static_cast<float>(noise.log_depth_sd);
  const auto inlier_share = static_cast<float>(1.0 - noise.outlier_share);
  const auto outlier_density = static_cast<float>(noise.outlier_share / noise.log_depth_range);
  for (std::size_t first = 0; first < particles; first += kRayBatch) {
    const std::vector<float> batch = particle_rows(poses, log_scales, particles, spread.centre, first, 1, kRayBatch);
    const std::vector<float> offsets = offsets_of(view, batch, kRayBatch);
    Candidates own;
    if (!alike) own = candidates_of(view, batch, offsets, scan_rows, points);
    const Candidates& candidates = alike ? shared : own;
    std::vector<float> scratch(3 * kPadding * view.components);
    double result[kRayBatch];
    kernels().weigh_rays(view, batch.data(), offsets.data(), scan_rows.data(), weights.data(), points,
                         candidates.components.data(), candidates.first.data(), sd, inlier_share, outlier_density,
                         scratch.data(), result);
    std::copy(result, result + std::min(kRayBatch, particles - first), out + first);
  }
}

}  // namespace monoloc
