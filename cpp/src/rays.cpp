#include "monoloc/rays.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>

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

// Input of the shortlist: the components, as seen by the mean camera, and how far the cameras are from it.
struct Shortlist {
  std::vector<float> rows;  // 13 rows of `stride`: whiten (6), offsets (3), log2_peak, norm, least, reach
  std::size_t stride = 0;
  float moved = 0.0f, turned = 0.0f;
  double rotation[9] = {};  // of the mean camera, row-major

  ShortlistView view() const {
    const float* at = rows.data();
    return {at,          at + 6 * stride,  at + 9 * stride,  at + 10 * stride,
            at + 11 * stride, at + 12 * stride, stride, moved, turned};
  }
};

// Mean of cameras, as rows of `stride` floats, and the largest distances from it; of rotations, in Frobenius' norm.
struct Cameras {
  double rotation[9] = {}, centre[3] = {};
  double moved = 0.0, turned = 0.0;

  Cameras(const std::vector<float>& rows, std::size_t stride) {
    const auto value = [&](std::size_t row, std::size_t i) { return static_cast<double>(rows[row * stride + i]); };
    for (std::size_t i = 0; i < stride; ++i) {
      for (std::size_t r = 0; r < 9; ++r) rotation[r] += value(r, i) / static_cast<double>(stride);
      for (std::size_t r = 0; r < 3; ++r) centre[r] += value(10 + r, i) / static_cast<double>(stride);
    }
    for (std::size_t i = 0; i < stride; ++i) {
      double by = 0.0, around = 0.0;
      for (std::size_t r = 0; r < 3; ++r) by += std::pow(value(10 + r, i) - centre[r], 2);
      for (std::size_t r = 0; r < 9; ++r) around += std::pow(value(r, i) - rotation[r], 2);
      moved = std::max(moved, std::sqrt(by));
      turned = std::max(turned, std::sqrt(around));
    }
  }
};

// Frobenius norms of a lower triangular matrix (0), (1, 2), (3, 4, 5), and of its inverse.
double norm_of(const float* w) {
  double squares = 0.0;
  for (int i = 0; i < 6; ++i) squares += static_cast<double>(w[i]) * w[i];
  return std::sqrt(squares);
}

double inverse_norm_of(const float* w) {
  const double a = w[0], b = w[2], c = w[5];
  const double entries[6] = {1.0 / a, 1.0 / b, 1.0 / c, w[1] / (a * b), w[4] / (b * c),
                             (static_cast<double>(w[1]) * w[4] - b * w[3]) / (a * b * c)};
  double squares = 0.0;
  for (const double entry : entries) squares += entry * entry;
  return std::sqrt(squares);
}

Shortlist shortlist_of(const RayView& view, const std::vector<float>& particles, std::size_t particle_stride) {
  const Cameras cameras(particles, particle_stride);
  Shortlist list;
  list.stride = padded(view.components);
  list.moved = static_cast<float>(cameras.moved);
  list.turned = static_cast<float>(cameras.turned);
  std::copy(cameras.rotation, cameras.rotation + 9, list.rotation);
  list.rows.assign(13 * list.stride, 0.0f);
  const auto put = [&](std::size_t row, std::size_t k, double value) {
    list.rows[row * list.stride + k] = static_cast<float>(value);
  };
  for (std::size_t k = 0; k < list.stride; ++k) {  // padding: a unit Gaussian without mass
    put(0, k, 1.0);
    put(2, k, 1.0);
    put(5, k, 1.0);
    put(9, k, -1e9);
    put(11, k, 1.0);
  }
  for (std::size_t k = 0; k < view.components; ++k) {
    const float* w = view.whiten + 6 * k;
    double offset[3];
    for (int axis = 0; axis < 3; ++axis) offset[axis] = view.means[3 * k + axis] - cameras.centre[axis];
    const double y[3] = {w[0] * offset[0], w[1] * offset[0] + w[2] * offset[1],
                         w[3] * offset[0] + w[4] * offset[1] + w[5] * offset[2]};
    for (std::size_t i = 0; i < 6; ++i) put(i, k, w[i]);
    for (std::size_t i = 0; i < 3; ++i) put(6 + i, k, y[i]);
    put(9, k, view.log2_peak[k]);
    put(10, k, norm_of(w));
    put(11, k, 1.0 / inverse_norm_of(w));
    put(12, k, std::sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2]));
  }
  return list;
}

// Components that may matter along the ray (x, y, 1) of any of the cameras; returns their number.
std::size_t list_neighbours(const Shortlist& shortlist, float x, float y, std::vector<float>& bounds,
                            std::vector<std::uint32_t>& listed) {
  float ray[3];
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const double* row = shortlist.rotation + 3 * axis;
    ray[axis] = static_cast<float>(row[0] * x + row[1] * y + row[2]);
  }
  ShortlistView view = shortlist.view();
  view.turned *= std::sqrt(x * x + y * y + 1.0f);
  return kernels().ray_shortlist(view, ray, kLeastLog2, bounds.data(), listed.data());
}

// Components that matter along each ray; those of point p are from first[p] up to first[p + 1].
struct Candidates {
  std::vector<std::uint32_t> components;
  std::vector<std::size_t> first;
};

// Selection of components at the given particles; scan: x / z, then y / z. alike: whether the particles are so close
// together that a shortlist is short.
Candidates candidates_of(const RayView& view, const std::vector<float>& particles, const std::vector<float>& offsets,
                         std::size_t stride, const std::vector<float>& scan, std::size_t points, bool alike) {
  const Shortlist shortlist = alike ? shortlist_of(view, particles, stride) : Shortlist{};
  Candidates candidates;
  candidates.first.resize(points + 1);
  std::vector<float> bounds(shortlist.stride), scratch(view.components * stride);
  std::vector<std::uint32_t> listed(padded(view.components) + 1);
  std::iota(listed.begin(), listed.end(), 0u);
  for (std::size_t p = 0; p < points; ++p) {
    const float x = scan[p], y = scan[points + p];
    const std::size_t count = alike ? list_neighbours(shortlist, x, y, bounds, listed) : view.components;
    const std::size_t first = candidates.first[p];
    candidates.components.resize(first + count + 1);  // one more than the kernel can return
    candidates.first[p + 1] =
        first + kernels().ray_candidates(view, particles.data(), offsets.data(), stride, x, y, kLeastLog2,
                                         listed.data(), count, scratch.data(), candidates.components.data() + first);
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
    const std::size_t count = std::min(kFew, padded(particles)), step = (particles + count - 1) / count;
    const std::vector<float> few = particle_rows(poses, log_scales, particles, spread.centre, 0, step, count);
    shared = candidates_of(view, few, offsets_of(view, few, count), count, scan_rows, points, true);
  }
  const auto sd = static_cast<float>(noise.log_depth_sd);
  const auto inlier_share = static_cast<float>(1.0 - noise.outlier_share);
  const auto outlier_density = static_cast<float>(noise.outlier_share / noise.log_depth_range);
  run_on_threads((particles + kRayBatch - 1) / kRayBatch, threads, [&](std::size_t share) {
    const std::size_t first = share * kRayBatch;
    const std::vector<float> batch = particle_rows(poses, log_scales, particles, spread.centre, first, 1, kRayBatch);
    const std::vector<float> offsets = offsets_of(view, batch, kRayBatch);
    Candidates own;
    if (!alike) own = candidates_of(view, batch, offsets, kRayBatch, scan_rows, points, false);
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
