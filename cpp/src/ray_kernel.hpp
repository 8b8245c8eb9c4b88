// Mixtures along rays; part of kernels.cpp, see there.
//
// With y = whiten (mean - o) and u = whiten r, the ray o + d r is nearest to a component, in Mahalanobis distance, at
// depth y.u / u.u. The log2-density there is peak - |y - d u|^2. The precision of d is |u|^2 (times 2 ln 2, because
// whiten is scaled for base 2).
#pragma once

#include "monoloc/kernels.hpp"
#include "simd.hpp"

namespace monoloc {
namespace {

constexpr float kPrecision = 1.3862943611198906f;  // 2 ln 2
constexpr float kHalfLog2E = 0.72134752044448170f;

// 1 / sqrt(x) in single precision, x positive: Newton's method from an initial value by the exponent's bits.
MONOLOC_INLINE FW inverse_root(FW x) {
  FW y = bits<FW>(0x5F375A86 - (bits<IW>(x) >> 1));
  for (int i = 0; i < 3; ++i) y = y * (1.5f - 0.5f * x * y * y);
  return y;
}

constexpr float kRoughLog2 = 0.0861f;

// log2 of a positive number, at most kRoughLog2 too small: between powers of two, the bits go in a straight line.
MONOLOC_INLINE FW rough_log2(FW x) { return convert<FW>(bits<IW>(x)) * (1.0f / (1 << 23)) - 127.0f; }

// Intersection of kWide rays with one component: depth, inverse root of |u|^2, and log2-density there.
struct Cut {
  FW depth, inverse_root, log2_peak;
};

MONOLOC_INLINE Cut cut(const float* whiten, float log2_peak, const float* offset, std::size_t stride, FW rx, FW ry,
                       FW rz) {
  const FW u0 = rx * whiten[0];
  const FW u1 = rx * whiten[1] + ry * whiten[2];
  const FW u2 = rx * whiten[3] + (ry * whiten[4] + rz * whiten[5]);
  const FW y0 = load<FW>(offset), y1 = load<FW>(offset + stride), y2 = load<FW>(offset + 2 * stride);
  const FW root = inverse_root(u0 * u0 + (u1 * u1 + u2 * u2));
  const FW depth = (u0 * y0 + (u1 * y1 + u2 * y2)) * root * root;
  const FW e0 = y0 - depth * u0, e1 = y1 - depth * u1, e2 = y2 - depth * u2;
  // Components behind the camera are invisible.
  const FW peak = choose(depth > splat<FW>(kNearest), log2_peak - (e0 * e0 + (e1 * e1 + e2 * e2)), splat<FW>(-1e9f));
  return {depth, root, peak};
}

void ray_offsets(const RayView& view, const float* centres, std::size_t stride, float* out) {
  for (std::size_t k = 0; k < view.components; ++k, out += 3 * stride) {
    const float *w = view.whiten + 6 * k, *mean = view.means + 3 * k;
    for (std::size_t i = 0; i < stride; i += kWide) {
      const FW x = mean[0] - load<FW>(centres + i);
      const FW y = mean[1] - load<FW>(centres + stride + i);
      const FW z = mean[2] - load<FW>(centres + 2 * stride + i);
      store(out + i, x * w[0]);
      store(out + stride + i, x * w[1] + y * w[2]);
      store(out + 2 * stride + i, x * w[3] + (y * w[4] + z * w[5]));
    }
  }
}

MONOLOC_INLINE void turn(const float* rotations, std::size_t stride, float x, float y, float* rays,
                         std::size_t ray_stride, std::size_t i) {
  for (int axis = 0; axis < 3; ++axis) {
    const float* row = rotations + 3 * axis * stride + i;
    store(rays + axis * ray_stride + i, load<FW>(row) * x + (load<FW>(row + stride) * y + load<FW>(row + 2 * stride)));
  }
}

// Bounds of a component's mass over all neighbours of a ray follow from the triangle inequality. For a neighbour, y
// changes by at most norm * moved and u by at most norm * turned, so its depth is at most (|y| + norm * moved) / |u|.
std::size_t ray_shortlist(const ShortlistView& view, const float* ray, float least, float* scratch,
                          std::uint32_t* out) {
  const std::size_t stride = view.stride;
  const FW zero = splat<FW>(0.0f);
  FW largest = splat<FW>(-1e9f);
  for (std::size_t k = 0; k < stride; k += kWide) {
    const auto row = [&view, stride, k](int r) MONOLOC_INLINE_LAMBDA {
      return load<FW>(view.whiten + r * stride + k);
    };
    const FW u0 = row(0) * ray[0], u1 = row(1) * ray[0] + row(2) * ray[1];
    const FW u2 = row(3) * ray[0] + (row(4) * ray[1] + row(5) * ray[2]);
    const FW y0 = load<FW>(view.offsets + k), y1 = load<FW>(view.offsets + stride + k);
    const FW y2 = load<FW>(view.offsets + 2 * stride + k);
    const FW norm = load<FW>(view.norm + k), reach = load<FW>(view.reach + k);
    const FW squared = u0 * u0 + (u1 * u1 + u2 * u2), root = inverse_root(squared), length = squared * root;
    const FW along = u0 * y0 + (u1 * y1 + u2 * y2), depth = along * root * root;
    const FW e0 = y0 - depth * u0, e1 = y1 - depth * u1, e2 = y2 - depth * u2;
    const FW e_squared = e0 * e0 + (e1 * e1 + e2 * e2) + 1e-12f, e = e_squared * inverse_root(e_squared);
    const FW by = norm * view.moved, around = norm * view.turned;
    const FW shortest = larger(length - around, load<FW>(view.least + k)), longest = length + around;
    const FW farthest = (reach + by) / shortest;
    const FW nearer = larger(e - by - farthest * around, zero);
    const FW farther = e + by + larger(depth, -depth) * around;
    const FW peak = load<FW>(view.log2_peak + k);
    const FW most = peak - nearer * nearer - rough_log2(shortest);
    const FW fewest = peak - farther * farther - rough_log2(longest) - kRoughLog2;
    const FW change = length * by + reach * around + by * around;  // of the product of u and y
    store(scratch + k, choose(along + change > kNearest * shortest * shortest, most, splat<FW>(-2e9f)));
    const IW is_certain = along - change > kNearest * longest * longest;
    largest = larger(largest, choose(is_certain, fewest, splat<FW>(-1e9f)));
  }
  float bound = -1e9f;
  for (std::size_t lane = 0; lane < kWide; ++lane) bound = largest[lane] > bound ? largest[lane] : bound;
  std::size_t count = 0;
  for (std::size_t k = 0; k < stride; ++k) {
    out[count] = static_cast<std::uint32_t>(k);
    count += scratch[k] > bound + least;
  }
  return count;
}

std::size_t ray_candidates(const RayView& view, const float* rotations, const float* offsets, std::size_t stride,
                           float x, float y, float least, const std::uint32_t* shortlist, std::size_t listed,
                           float* scratch, std::uint32_t* out) {
  alignas(64) float rays[3 * kRayBatch], largest[kRayBatch];
  for (std::size_t i = 0; i < stride; i += kWide) {
    turn(rotations, stride, x, y, rays, kRayBatch, i);
    store(largest + i, splat<FW>(-1e9f));
  }
  for (std::size_t s = 0; s < listed; ++s) {
    const std::size_t k = shortlist[s];
    for (std::size_t i = 0; i < stride; i += kWide) {
      const Cut at = cut(view.whiten + 6 * k, view.log2_peak[k], offsets + 3 * k * stride + i, stride,
                         load<FW>(rays + i), load<FW>(rays + kRayBatch + i), load<FW>(rays + 2 * kRayBatch + i));
      const FW mass = at.log2_peak + rough_log2(at.inverse_root);
      store(scratch + s * stride + i, mass);
      store(largest + i, larger(load<FW>(largest + i), mass));
    }
  }
  std::size_t count = 0;
  for (std::size_t s = 0; s < listed; ++s) {
    IW matters{};
    for (std::size_t i = 0; i < stride; i += kWide) {
      matters |= load<FW>(scratch + s * stride + i) > load<FW>(largest + i) + (least - kRoughLog2);
    }
    std::int32_t any = 0;
    for (std::size_t lane = 0; lane < kWide; ++lane) any |= matters[lane];
    out[count] = shortlist[s];
    count += any != 0;
  }
  return count;
}

void weigh_rays(const RayView& view, const float* particles, const float* offsets, const float* scan,
                const float* point_weights, std::size_t points, const std::uint32_t* candidates,
                const std::size_t* first_candidate, float log_depth_sd, float inlier_share, float outlier_density,
                float* scratch, double* out) {
  constexpr std::size_t stride = kRayBatch;
  alignas(64) float rays[3 * stride], logs[stride];
  for (std::size_t i = 0; i < stride; ++i) out[i] = 0.0;
  const float variance = log_depth_sd * log_depth_sd;
  for (std::size_t p = 0; p < points; ++p) {
    const std::uint32_t* chosen = candidates + first_candidate[p];
    const std::size_t count = first_candidate[p + 1] - first_candidate[p];
    for (std::size_t i = 0; i < stride; i += kWide) {
      turn(particles, stride, scan[p], scan[points + p], rays, stride, i);
      const FW rx = load<FW>(rays + i), ry = load<FW>(rays + stride + i), rz = load<FW>(rays + 2 * stride + i);
      FW largest = splat<FW>(-1e9f);
      for (std::size_t c = 0; c < count; ++c) {
        const std::size_t k = chosen[c];
        const Cut at = cut(view.whiten + 6 * k, view.log2_peak[k], offsets + 3 * k * stride + i, stride, rx, ry, rz);
        store(scratch + 3 * c * kWide, at.depth);
        store(scratch + (3 * c + 1) * kWide, at.inverse_root);
        store(scratch + (3 * c + 2) * kWide, at.log2_peak);
        largest = larger(largest, at.log2_peak);
      }
      // Predicted depth times the particle's scale.
      const FW depth = load<FW>(particles + 9 * stride + i) * scan[2 * points + p];
      FW mass{}, density{};
      for (std::size_t c = 0; c < count; ++c) {
        const FW surface = load<FW>(scratch + 3 * c * kWide), root = load<FW>(scratch + (3 * c + 1) * kWide);
        const FW part = exp2_fast<FW, UW>(load<FW>(scratch + (3 * c + 2) * kWide) - largest) * root;
        const FW spread = inverse_root(root * root * (1.0f / kPrecision) + variance * surface * surface);
        const FW off = (depth - surface) * spread;
        mass += part;
        density += part * spread * exp2_fast<FW, UW>(off * off * -kHalfLog2E);
      }
      // Without a surface in front of the camera, only an outlier is possible.
      const FW seen = choose(largest > splat<FW>(-1e8f), density / mass, splat<FW>(0.0f));
      const FW mixed = seen * depth * (inlier_share * 0.39894228040143268f) + outlier_density;
      store(logs + i, log_fast<FW, IW>(mixed) * point_weights[p]);
    }
    for (std::size_t i = 0; i < stride; ++i) out[i] += static_cast<double>(logs[i]);
  }
}

}  // namespace
}  // namespace monoloc
