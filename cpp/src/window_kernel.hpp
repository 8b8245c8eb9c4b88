// Linearised observations of a window; part of kernels.cpp, see there. A vector holds one value of kWide64 corners.
#pragma once

#include <cmath>
#include <cstddef>

#include "monoloc/kernels.hpp"
#include "simd.hpp"

namespace monoloc {
namespace {

constexpr double kHuber = 2.0;  // standard deviations beyond which the loss of a residual is linear
constexpr double kPointDamping = 1e-9;
constexpr double kNearestM = 0.05;

struct DW3 {
  DW v[3];
};

MONOLOC_INLINE DW3 cross(const DW3& a, const DW3& b) {
  return {{a.v[1] * b.v[2] - a.v[2] * b.v[1], a.v[2] * b.v[0] - a.v[0] * b.v[2], a.v[0] * b.v[1] - a.v[1] * b.v[0]}};
}

// Of three rows of `stride` doubles.
MONOLOC_INLINE DW3 load3(const double* from, std::size_t stride) {
  return {{load<DW>(from), load<DW>(from + stride), load<DW>(from + 2 * stride)}};
}

MONOLOC_INLINE void store3(double* to, std::size_t stride, const DW3& values) {
  for (std::size_t i = 0; i < 3; ++i) store(to + i * stride, values.v[i]);
}

MONOLOC_INLINE DW square_root(DW x) {
  for (std::size_t lane = 0; lane < kWide64; ++lane) x[lane] = std::sqrt(x[lane]);
  return x;
}

MONOLOC_INLINE DW logarithm(DW x) {
  for (std::size_t lane = 0; lane < kWide64; ++lane) x[lane] = std::log(x[lane]);
  return x;
}

// Square root of Huber's weight, by the square of a residual.
MONOLOC_INLINE DW huber_weight(DW squared) {
  const DW most = splat<DW>(kHuber * kHuber);
  return any_greater(squared, most) ? square_root(kHuber / square_root(larger(squared, most))) : splat<DW>(1.0);
}

// Observations of one keyframe, by the points' places in its frame: normal matrix of the position, which has no xy;
// that of the depth, which adds to zz; and gradient.
struct Observed {
  DW xx, yy, xz, yz, zz, depth;
  DW3 gradient;
};

// known: the keyframe's rows, see WindowView.
MONOLOC_INLINE Observed observed(const WindowView& view, const double* known, const DW3& local) {
  const DW3 seen = load3(known, view.stride), has = load3(known + 3 * view.stride, view.stride);
  const DW z = larger(local.v[2], splat<DW>(kNearestM)), inverse_z = 1.0 / z;
  const DW u = local.v[0] * inverse_z, v = local.v[1] * inverse_z;
  const DW x = has.v[0] * (u - seen.v[0]) * view.ray_scale, y = has.v[1] * (v - seen.v[1]) * view.ray_scale;
  const DW d = has.v[2] * (logarithm(z) - seen.v[2]) * view.log_depth_scale;
  const DW weight = huber_weight(x * x + y * y), depth_weight = huber_weight(d * d);
  const DW scale = weight * inverse_z * view.ray_scale, by_x = has.v[0] * scale, by_y = has.v[1] * scale;
  const DW by_d = has.v[2] * depth_weight * inverse_z * view.log_depth_scale;
  const DW xx = by_x * by_x, yy = by_y * by_y, gx = by_x * weight * x, gy = by_y * weight * y;
  return {xx, yy, -xx * u, -yy * v, xx * u * u + yy * v * v, by_d * by_d,
          {{gx, gy, by_d * depth_weight * d - gx * u - gy * v}}};
}

// Adds to a keyframe's sums, see WindowSums. With J the derivative by the point in the camera's frame, that by the
// twist is J (-I, hat(local)).
MONOLOC_INLINE void add_to_pose(const Observed& o, const DW3& local, double* sums) {
  const DW zero = splat<DW>(0.0), zz = o.zz + o.depth;
  const DW3 normal[3] = {{{o.xx, zero, o.xz}}, {{zero, o.yy, o.yz}}, {{o.xz, o.yz, zz}}};
  DW3 turned[3];  // rows of the normal matrix times hat(local)
  for (std::size_t i = 0; i < 3; ++i) turned[i] = cross(normal[i], local);
  const DW3 by_phi = cross(local, o.gradient);
  for (std::size_t j = 0; j < 3; ++j) {
    const DW3 column = cross(local, {{turned[0].v[j], turned[1].v[j], turned[2].v[j]}});
    const DW added[11] = {normal[0].v[j],  normal[1].v[j],  normal[2].v[j],    -turned[0].v[j],
                          -turned[1].v[j], -turned[2].v[j], -column.v[0],      -column.v[1],
                          -column.v[2],    -o.gradient.v[j], -by_phi.v[j]};
    for (std::size_t i = 0; i < 11; ++i) {
      double* sum = sums + (3 * i + j) * kPadding;
      store(sum, load<DW>(sum) + added[i]);
    }
  }
}

// Inverse of the Cholesky factor of a damped matrix xx xy xz yy yz zz: lower triangle, by rows.
MONOLOC_INLINE void whiten(const DW* matrix, DW* out) {
  const DW damped[3] = {matrix[0] * (1.0 + kWindowDamping) + kPointDamping,
                        matrix[3] * (1.0 + kWindowDamping) + kPointDamping,
                        matrix[5] * (1.0 + kWindowDamping) + kPointDamping};
  const DW i0 = 1.0 / square_root(damped[0]), l10 = matrix[1] * i0, l20 = matrix[2] * i0;
  const DW i1 = 1.0 / square_root(damped[1] - l10 * l10), l21 = (matrix[4] - l20 * l10) * i1;
  const DW i2 = 1.0 / square_root(damped[2] - l20 * l20 - l21 * l21);
  const DW inverse[6] = {i0, -l10 * i0 * i1, i1, (l10 * l21 * i1 - l20) * i0 * i2, -l21 * i1 * i2, i2};
  for (std::size_t i = 0; i < 6; ++i) out[i] = inverse[i];
}

MONOLOC_INLINE DW3 times(const DW* lower, const DW3& x) {
  return {{lower[0] * x.v[0], lower[1] * x.v[0] + lower[2] * x.v[1],
           lower[3] * x.v[0] + lower[4] * x.v[1] + lower[5] * x.v[2]}};
}

MONOLOC_INLINE bool is_seen(const WindowView& view, std::size_t frame, std::size_t n) {
  const DW3 has = load3(view.observations + (6 * frame + 3) * view.stride + n, view.stride);
  return any_greater(has.v[0] + has.v[1] + has.v[2], splat<DW>(0.0));
}

// Sums over the keyframes' observations of corners: normal matrices xx xy xz yy yz zz of the points, by their rays and
// by their depth, and gradient.
struct PointSums {
  DW of_rays[6] = {}, of_depth[6] = {};
  DW3 gradient = {};
};

// r: rotation of the camera. products: receives the observations' normal matrix times the rotation, by rows.
MONOLOC_INLINE void add_to_points(const Observed& o, const double* r, PointSums& sums, DW3* products) {
  for (std::size_t j = 0; j < 3; ++j) {
    products[0].v[j] = o.xx * r[j] + o.xz * r[6 + j];
    products[1].v[j] = o.yy * r[3 + j] + o.yz * r[6 + j];
    products[2].v[j] = o.xz * r[j] + o.yz * r[3 + j] + o.zz * r[6 + j];
  }
  std::size_t entry = 0;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t k = 0; k < 3; ++k) sums.gradient.v[i] += r[3 * k + i] * o.gradient.v[k];
    for (std::size_t j = i; j < 3; ++j, ++entry) {
      for (std::size_t k = 0; k < 3; ++k) sums.of_rays[entry] += r[3 * k + i] * products[k].v[j];
      sums.of_depth[entry] += o.depth * (r[6 + i] * r[6 + j]);
    }
  }
  for (std::size_t j = 0; j < 3; ++j) products[2].v[j] += o.depth * r[6 + j];
}

// Writes the entries of one keyframe into the corners' rows. products: three rows, see add_to_points.
MONOLOC_INLINE void write_rows(const DW3* products, const DW3& local, const DW* lower, std::size_t stride, double* to) {
  const DW3 whitened[3] = {times(lower, products[0]), times(lower, products[1]), times(lower, products[2])};
  for (std::size_t row = 0; row < 3; ++row) {
    const DW3 rho{{whitened[0].v[row], whitened[1].v[row], whitened[2].v[row]}}, phi = cross(rho, local);
    for (std::size_t lane = 0; lane < kWide64; ++lane) {
      double* corner = to + (3 * lane + row) * stride;
      for (std::size_t i = 0; i < 3; ++i) {
        corner[i] = -rho.v[i][lane];
        corner[3 + i] = phi.v[i][lane];
      }
    }
  }
}

void linearise_corners(const WindowView& view, std::size_t n, const WindowSums& sums) {
  const DW3 point = load3(view.points + n, view.stride);
  PointSums of_points;
  for (std::size_t w = 0; w < view.frames; ++w) {
    if (!is_seen(view, w, n)) continue;
    const double* camera = view.cameras + 12 * w;
    DW3 local, products[3];
    for (std::size_t i = 0; i < 3; ++i) {
      const double* r = camera + 3 * i;
      local.v[i] = r[0] * point.v[0] + r[1] * point.v[1] + r[2] * point.v[2] + camera[9 + i];
    }
    const Observed o = observed(view, view.observations + 6 * w * view.stride + n, local);
    add_to_points(o, camera, of_points, products);
    if (w == 0) continue;  // the first keyframe is fixed
    add_to_pose(o, local, sums.poses + w * kPoseSums * kPadding);
    double* kept = sums.scratch + 12 * w * kWide64;
    for (std::size_t i = 0; i < 3; ++i) store3(kept + 3 * i * kWide64, kWide64, products[i]);
    store3(kept + 9 * kWide64, kWide64, local);
  }
  DW whole[6], lower[6];
  for (std::size_t i = 0; i < 6; ++i) whole[i] = of_points.of_rays[i] + of_points.of_depth[i];
  whiten(whole, lower);
  for (std::size_t i = 0; i < 6; ++i) {
    store(sums.information + i * view.stride + n, of_points.of_rays[i]);
    store(sums.whiten + i * view.stride + n, lower[i]);
  }
  double* rows = sums.rows + 3 * n * sums.row_stride;
  const DW3 gradient = times(lower, of_points.gradient);
  for (std::size_t lane = 0; lane < kWide64; ++lane) {
    for (std::size_t row = 0; row < 3; ++row) {
      rows[(3 * lane + row) * sums.row_stride + 6 * (view.frames - 1)] = gradient.v[row][lane];
    }
  }
  for (std::size_t w = 1; w < view.frames; ++w) {
    if (!is_seen(view, w, n)) continue;
    const double* kept = sums.scratch + 12 * w * kWide64;
    DW3 products[3];
    for (std::size_t i = 0; i < 3; ++i) products[i] = load3(kept + 3 * i * kWide64, kWide64);
    write_rows(products, load3(kept + 9 * kWide64, kWide64), lower, sums.row_stride, rows + 6 * (w - 1));
  }
}

void linearise_window(const WindowView& view, std::size_t first, const WindowSums& sums) {
  for (std::size_t n = first; n < first + kPadding; n += kWide64) linearise_corners(view, n, sums);
}

}  // namespace
}  // namespace monoloc
