#include "monoloc/rays.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "padded.hpp"
#include "pool.hpp"

namespace monoloc {
namespace {

constexpr double kReach_m = 12.0;     // components farther from all particles are ignored
constexpr float kLeastLog2 = -17.0f;  // log2 of 1e-5; on a ray, components with a smaller share of mass are ignored
constexpr double kTypicalDepth_m = 2.0;
constexpr double kNarrow_m = 0.6;          // particles within this reach share one selection of components
constexpr std::size_t kFew = 32;           // particles at which the shared selection is made

// Some of the mixture's components, in the layout and precision of the kernels.
struct Rows {
  std::vector<float> whiten, means, log2_peak;

  RayView view() const { return {whiten.data(), means.data(), log2_peak.data(), log2_peak.size()}; }
};

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

Rows within(const std::vector<Component>& mixture, const double* centre, double reach) {
  Rows rows;
  for (const Component& component : mixture) {
    double offset[3], squared = 0.0;
    for (int axis = 0; axis < 3; ++axis) {
      offset[axis] = component.mean[axis] - centre[axis];
      squared += offset[axis] * offset[axis];
    }
    if (squared > reach * reach || !std::isfinite(component.log2_peak)) continue;
    for (int i = 0; i < 6; ++i) rows.whiten.push_back(static_cast<float>(component.whiten[i]));
    for (int axis = 0; axis < 3; ++axis) rows.means.push_back(static_cast<float>(offset[axis]));
    rows.log2_peak.push_back(static_cast<float>(component.log2_peak));
  }
  return rows;
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

std::vector<float> offsets_of(const RayView& view, const std::vector<float>& particles, std::size_t stride) {
  std::vector<float> offsets(3 * stride * view.components);
  kernels().ray_offsets(view, particles.data() + 10 * stride, stride, offsets.data());
  return offsets;
}

// Components that matter along each ray; those of point p are from first[p] up to first[p + 1].
struct Candidates {
  std::vector<std::uint32_t> components;
  std::vector<std::size_t> first;
};

// Selection of components at the given particles; scan: x / z, then y / z.
Candidates candidates_of(const RayView& view, const std::vector<float>& particles, const std::vector<float>& offsets,
                         std::size_t stride, const std::vector<float>& scan, std::size_t points) {
  Candidates candidates;
  candidates.first.resize(points + 1);
  std::vector<float> scratch(view.components * stride);
  for (std::size_t p = 0; p < points; ++p) {
    const std::size_t first = candidates.first[p];
    candidates.components.resize(first + view.components + 1);  // one more than the kernel can return
    candidates.first[p + 1] =
        first + kernels().ray_candidates(view, particles.data(), offsets.data(), stride, scan[p], scan[points + p],
                                         kLeastLog2, scratch.data(), candidates.components.data() + first);
  }
  return candidates;
}

}  // namespace

RayMixture::RayMixture(const std::vector<Component>& mixture) : mixture_(mixture) {}

void RayMixture::weigh(const double* poses, const double* log_scales, std::size_t particles, const float* scan,
                       const float* point_weights, std::size_t points, const RayNoise& noise, std::size_t threads,
                       double* out) const {
  if (particles == 0) return;
  const Spread spread = spread_of(poses, particles);
  const Rows rows = within(mixture_, spread.centre, kReach_m + spread.radius);
  const RayView view = rows.view();

  std::vector<float> scan_rows(3 * points), weights(points, 1.0f);  // x / z, y / z, z
  for (std::size_t p = 0; p < points; ++p) {
    const float* point = scan + 3 * p;
    scan_rows[p] = point[0] / point[2];
    scan_rows[points + p] = point[1] / point[2];
    scan_rows[2 * points + p] = point[2];
    if (point_weights) weights[p] = point_weights[p];
  }

  const bool alike = spread.reach < kNarrow_m;
  Candidates shared;
  if (alike) {
    const std::size_t step = (particles + kFew - 1) / kFew;
    const std::vector<float> few = particle_rows(poses, log_scales, particles, spread.centre, 0, step, kFew);
    shared = candidates_of(view, few, offsets_of(view, few, kFew), kFew, scan_rows, points);
  }
  const auto sd = static_cast<float>(noise.log_depth_sd);
  const auto inlier_share = static_cast<float>(1.0 - noise.outlier_share);
  const auto outlier_density = static_cast<float>(noise.outlier_share / noise.log_depth_range);
  run_on_threads((particles + kRayBatch - 1) / kRayBatch, threads, [&](std::size_t share) {
    const std::size_t first = share * kRayBatch;
    const std::vector<float> batch = particle_rows(poses, log_scales, particles, spread.centre, first, 1, kRayBatch);
    const std::vector<float> offsets = offsets_of(view, batch, kRayBatch);
    Candidates own;
    if (!alike) own = candidates_of(view, batch, offsets, kRayBatch, scan_rows, points);
    const Candidates& candidates = alike ? shared : own;
    std::vector<float> scratch(3 * kPadding * view.components);
    double result[kRayBatch];
    kernels().weigh_rays(view, batch.data(), offsets.data(), scan_rows.data(), weights.data(), points,
                         candidates.components.data(), candidates.first.data(), sd, inlier_share, outlier_density,
                         scratch.data(), result);
    std::copy(result, result + std::min(kRayBatch, particles - first), out + first);
  });
}

}  // namespace monoloc
