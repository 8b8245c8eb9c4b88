// Likelihood of particles along rays.
#include <cmath>
#include <cstdint>
#include <numeric>
#include <random>
#include <vector>

#include "check.hpp"
#include "monoloc/kernels.hpp"
#include "monoloc/rays.hpp"
#include "room.hpp"
#include "tests.hpp"

namespace {

// Intersection of the ray from the origin along r with a component: depth, precision, and density there.
struct CutExactly {
  double depth, precision, density;

  CutExactly(const Room& room, std::size_t k, const double* origin, const double* r) {
    const monoloc::Component& c = room.components[k];
    const double d[3] = {c.mean[0] - origin[0], c.mean[1] - origin[1], c.mean[2] - origin[2]};
    const double* w = c.whiten;
    const double u[3] = {w[0] * r[0], w[1] * r[0] + w[2] * r[1], w[3] * r[0] + w[4] * r[1] + w[5] * r[2]};
    const double y[3] = {w[0] * d[0], w[1] * d[0] + w[2] * d[1], w[3] * d[0] + w[4] * d[1] + w[5] * d[2]};
    const double squared = u[0] * u[0] + u[1] * u[1] + u[2] * u[2];
    depth = (u[0] * y[0] + u[1] * y[1] + u[2] * y[2]) / squared;
    precision = 2.0 * std::log(2.0) * squared;
    const double nearest[3] = {origin[0] + depth * r[0], origin[1] + depth * r[1], origin[2] + depth * r[2]};
    density = room.density(k, nearest);
  }
};

// log((1 - eps) d p(d | ray) + eps / range) of a point in front of a camera without rotation.
double log_along_ray(const Room& room, const double* origin, const double* point, double sd, double inlier_share,
                     double outlier_density) {
  const double r[3] = {point[0] / point[2], point[1] / point[2], 1.0}, pi = 3.14159265358979323846;
  double mass = 0.0, density = 0.0;
  for (std::size_t k = 0; k < room.components.size(); ++k) {
    const CutExactly at(room, k, origin, r);
    if (at.depth <= static_cast<double>(monoloc::kNearest)) continue;
    const double part = at.density * std::sqrt(2.0 * pi / at.precision);
    const double variance = 1.0 / at.precision + sd * sd * at.depth * at.depth;
    const double off = point[2] - at.depth;
    mass += part;
    density += part * std::exp(-0.5 * off * off / variance) / std::sqrt(2.0 * pi * variance);
  }
  return std::log(inlier_share * (mass > 0.0 ? point[2] * density / mass : 0.0) + outlier_density);
}

}  // namespace

// All ray kernels (offsets, selection of components, likelihoods) at kRayBatch cameras without rotation, 3 m in front
// of the room.
void test_rays(const monoloc::Kernels& kernels) {
  const std::size_t components = 40, points = 23, stride = monoloc::kRayBatch;
  const Room room(components);
  std::vector<float> whiten, means, peaks, particles(10 * stride, 0.0f), centres(3 * stride), scan(3 * points);
  for (const monoloc::Component& c : room.components) {
    for (int i = 0; i < 6; ++i) whiten.push_back(static_cast<float>(c.whiten[i]));
    for (int axis = 0; axis < 3; ++axis) means.push_back(static_cast<float>(c.mean[axis]));
    peaks.push_back(static_cast<float>(c.log2_peak));
  }
  const monoloc::RayView view{whiten.data(), means.data(), peaks.data(), components};
  std::mt19937_64 random(4);
  std::uniform_real_distribution<float> place(-0.1f, 0.1f);
  for (std::size_t n = 0; n < stride; ++n) {
    for (const std::size_t diagonal : {0, 4, 8}) particles[diagonal * stride + n] = 1.0f;
    particles[9 * stride + n] = 1.0f + place(random);
    for (std::size_t axis = 0; axis < 3; ++axis) centres[axis * stride + n] = place(random) - (axis == 2 ? 3.0f : 0.0f);
  }
  for (std::size_t p = 0; p < points; ++p) {
    scan[p] = 2.0f * place(random);
    scan[points + p] = 2.0f * place(random);
    scan[2 * points + p] = 3.0f + 10.0f * place(random);
  }

  std::vector<float> offsets(3 * stride * components);
  kernels.ray_offsets(view, centres.data(), stride, offsets.data());

  const float least = -17.0f;
  std::vector<std::size_t> first(points + 1, 0);
  std::vector<std::uint32_t> candidates;
  std::vector<float> masses(components * stride), scratch(3 * monoloc::kPadding * components);
  std::vector<std::uint32_t> every(components);
  std::iota(every.begin(), every.end(), 0u);
  bool all_chosen_that_matter = true;
  for (std::size_t p = 0; p < points; ++p) {
    candidates.resize(first[p] + components + 1);
    const std::size_t count =
        kernels.ray_candidates(view, particles.data(), offsets.data(), stride, scan[p], scan[points + p], least,
                               every.data(), components, masses.data(), &candidates[first[p]]);
    first[p + 1] = first[p] + count;
    for (std::size_t n = 0; n < stride; ++n) {
      const double origin[3] = {centres[n], centres[stride + n], centres[2 * stride + n]};
      const double r[3] = {scan[p], scan[points + p], 1.0};
      std::vector<double> mass(components);
      double largest = 0.0;
      for (std::size_t k = 0; k < components; ++k) {
        const CutExactly at(room, k, origin, r);
        mass[k] = at.depth > static_cast<double>(monoloc::kNearest) ? at.density / std::sqrt(at.precision) : 0.0;
        largest = std::max(largest, mass[k]);
      }
      for (std::size_t k = 0; k < components; ++k) {
        if (mass[k] < largest * std::exp2(least + 0.01)) continue;
        bool is_chosen = false;
        for (std::size_t c = first[p]; c < first[p + 1]; ++c) is_chosen |= candidates[c] == k;
        all_chosen_that_matter &= is_chosen;
      }
    }
  }
  CHECK(all_chosen_that_matter);
  CHECK(first[points] < points * components);  // some components were omitted

  const float sd = 0.05f, inlier_share = 0.7f, outlier_density = 0.3f / 4.0f;
  std::vector<float> weights(points);
  for (std::size_t p = 0; p < points; ++p) weights[p] = 0.5f + 0.1f * static_cast<float>(p % 7);
  std::vector<double> weighed(stride);
  kernels.weigh_rays(view, particles.data(), offsets.data(), scan.data(), weights.data(), points, candidates.data(),
                     first.data(), sd, inlier_share, outlier_density, scratch.data(), weighed.data());
  double worst = 0.0;
  for (std::size_t n = 0; n < stride; ++n) {
    const double origin[3] = {centres[n], centres[stride + n], centres[2 * stride + n]};
    double expected = 0.0;
    for (std::size_t p = 0; p < points; ++p) {
      const double z = static_cast<double>(particles[9 * stride + n]) * scan[2 * points + p];
      const double point[3] = {scan[p] * z, scan[points + p] * z, z};
      expected += weights[p] * log_along_ray(room, origin, point, sd, inlier_share, outlier_density);
    }
    worst = std::max(worst, std::abs(weighed[n] - expected));
  }
  CHECK(worst < 2e-3);
}

// End to end: particles far apart and close together.
void test_ray_mixture() {
  const Room room(40);
  const monoloc::RayMixture rays(room.components);
  const monoloc::RayNoise noise{0.05, 0.3, 4.0};
  const std::size_t count = 150, points = 20;
  std::mt19937_64 random(5);
  for (const double spread : {0.01, 2.0}) {
    std::uniform_real_distribution<double> place(-spread, spread), side(-0.3, 0.3);
    std::vector<double> poses(16 * count, 0.0), log_scales(count), weighed(count);
    std::vector<float> scan(3 * points);
    for (std::size_t n = 0; n < count; ++n) {
      for (const std::size_t diagonal : {0, 5, 10, 15}) poses[16 * n + diagonal] = 1.0;
      for (const std::size_t axis : {3, 7, 11}) poses[16 * n + axis] = place(random) - (axis == 11 ? 3.5 : 0.0);
      log_scales[n] = 0.1 * side(random);
    }
    for (std::size_t i = 0; i < scan.size(); ++i) {
      scan[i] = static_cast<float>((i % 3 == 2 ? 3.0 : 0.0) + side(random));
    }
    rays.weigh(poses.data(), log_scales.data(), count, scan.data(), nullptr, points, noise, weighed.data());
    double worst = 0.0;
    for (std::size_t n = 0; n < count; ++n) {
      const double origin[3] = {poses[16 * n + 3], poses[16 * n + 7], poses[16 * n + 11]}, s = std::exp(log_scales[n]);
      double expected = 0.0;
      for (std::size_t p = 0; p < points; ++p) {
        const double point[3] = {s * scan[3 * p], s * scan[3 * p + 1], s * scan[3 * p + 2]};
        expected += log_along_ray(room, origin, point, 0.05, 0.7, 0.3 / 4.0);
      }
      worst = std::max(worst, std::abs(weighed[n] - expected));
    }
    CHECK(worst < 1e-3 * static_cast<double>(points));
  }
}
