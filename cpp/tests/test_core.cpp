// Every set of kernels this processor runs, against plain loops in double precision.
#include <cmath>
#include <cstdio>
#include <random>
#include <stdexcept>
#include <vector>

#include "monoloc/index.hpp"
#include "monoloc/kernels.hpp"
#include "monoloc/mixture.hpp"
#include "monoloc/rays.hpp"

namespace {

int failures = 0;

void check(bool holds, const char* what, int line) {
  if (holds) return;
  std::printf("line %d: %s\n", line, what);
  ++failures;
}
#define CHECK(condition) check((condition), #condition, __LINE__)

// A room of flat components: weights, means (K, 3), covariances (K, 3, 3).
struct Room {
  std::vector<double> weights, means, covariances;
  std::vector<monoloc::Component> components;

  explicit Room(std::size_t count) : means(3 * count), covariances(9 * count, 0.0) {
    std::mt19937_64 random(1);
    std::uniform_real_distribution<double> place(-1.0, 1.0);
    weights.assign(count, 1.0 / static_cast<double>(count));
    for (double& m : means) m = place(random);
    const double sigma[3] = {0.15, 0.1, 0.015};
    for (std::size_t k = 0; k < count; ++k) {
      // Covariance = B diag(sigma^2) B^T for a random shear B, which is positive definite.
      double b[9];
      for (int i = 0; i < 9; ++i) b[i] = (i % 4 == 0 ? 1.0 : 0.0) + 0.5 * place(random);
      for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
          for (int m = 0; m < 3; ++m) covariances[9 * k + 3 * i + j] += b[3 * i + m] * b[3 * j + m] * sigma[m] * sigma[m];
        }
      }
    }
    components = monoloc::make_components(weights.data(), means.data(), covariances.data(), count);
  }

  // weight * density of component k at x.
  double density(std::size_t k, const double* x) const {
    const monoloc::Component& c = components[k];
    const double d[3] = {x[0] - c.mean[0], x[1] - c.mean[1], x[2] - c.mean[2]};
    const double* w = c.whiten;
    const double y[3] = {w[0] * d[0], w[1] * d[0] + w[2] * d[1], w[3] * d[0] + w[4] * d[1] + w[5] * d[2]};
    return std::exp2(c.log2_peak - y[0] * y[0] - y[1] * y[1] - y[2] * y[2]);
  }

  double density(const double* x) const {
    double sum = 0.0;
    for (std::size_t k = 0; k < components.size(); ++k) sum += density(k, x);
    return sum;
  }

  // Points about the components' means.
  std::vector<double> points(std::size_t count, double spread) const {
    std::mt19937_64 random(2);
    std::normal_distribution<double> normal(0.0, spread);
    std::vector<double> x(3 * count);
    for (std::size_t i = 0; i < x.size(); ++i) x[i] = means[i % means.size()] + normal(random);
    return x;
  }
};

void test_whitening() {
  // A diagonal covariance has a density that can be written down.
  const double weight = 1.0, mean[3] = {1.0, 2.0, 3.0}, covariance[9] = {4.0, 0, 0, 0, 9.0, 0, 0, 0, 0.25};
  const auto components = monoloc::make_components(&weight, mean, covariance, 1);
  const double x[3] = {3.0, 5.0, 3.5};  // one standard deviation along each axis
  double result = 0.0;
  monoloc::log_density(components, x, 1, &result);
  const double expected = -1.5 - 1.5 * std::log(2.0 * 3.14159265358979323846) - std::log(2.0 * 3.0 * 0.5);
  CHECK(std::abs(result - expected) < 1e-12);
}

void test_rejects_indefinite() {
  const double weight = 1.0, mean[3] = {}, covariance[9] = {1.0, 2.0, 0, 2.0, 1.0, 0, 0, 0, 1.0};
  bool thrown = false;
  try {
    monoloc::make_components(&weight, mean, covariance, 1);
  } catch (const std::invalid_argument&) {
    thrown = true;
  }
  CHECK(thrown);
}

void test_log_density_and_expectation() {
  const Room room(30);
  const std::size_t count = 101;  // no multiple of any vector's length
  const std::vector<double> x = room.points(count, 0.3);
  std::vector<double> result(count);
  monoloc::log_density(room.components, x.data(), count, result.data());
  double worst = 0.0, log_likelihood = 0.0, mass = 0.0, second = 0.0;
  for (std::size_t i = 0; i < count; ++i) {
    const double total = room.density(&x[3 * i]);
    worst = std::max(worst, std::abs(result[i] - std::log(total)));
    log_likelihood += std::log(total);
    const double r = room.density(7, &x[3 * i]) / total;
    mass += r;
    second += r * (x[3 * i] - room.means[21]) * (x[3 * i + 2] - room.means[23]);
  }
  CHECK(worst < 1e-11);
  const monoloc::Expectation e = monoloc::expectation(room.components, x.data(), count);
  CHECK(std::abs(e.log_likelihood - log_likelihood) < 1e-9);
  CHECK(std::abs(e.mass[7] - mass) < 1e-11);
  CHECK(std::abs(e.second[6 * 7 + 2] - second) < 1e-11);
  double all = 0.0;
  for (const double m : e.mass) all += m;
  CHECK(std::abs(all - static_cast<double>(count)) < 1e-9);
}

void test_index() {
  const Room room(100);
  const double floor = 0.01, tolerance = 0.02;
  const monoloc::MixtureIndex index(room.components, {0.1, floor, tolerance});
  const std::size_t count = 5000;
  const std::vector<double> x = room.points(count, 0.2);
  std::vector<double> result(count);
  index.log_density(x.data(), count, result.data());
  double worst = 0.0;
  for (std::size_t i = 0; i < count; ++i) {
    const double exact = std::log(room.density(&x[3 * i]) + floor);
    worst = std::max(worst, std::abs(std::log(std::exp(result[i]) + floor) - exact));
  }
  CHECK(worst < 2.0 * tolerance);
  const double far[3] = {1e6, -1e9, 0.0};
  index.log_density(far, 1, result.data());
  CHECK(std::isinf(result[0]) && result[0] < 0.0);

  // Two particles with a scale: the same as the density at the points moved by hand.
  const double poses[32] = {0, -1, 0, 0.1, 1, 0, 0, 0.2, 0, 0, 1, -0.1, 0, 0, 0, 1,
                            1, 0,  0, 0.0, 0, 1, 0, 0.0, 0, 0, 1, 0.0,  0, 0, 0, 1};
  const double log_scales[2] = {std::log(1.5), 0.0};
  const float scan[6] = {0.2f, 0.1f, 0.3f, -0.4f, 0.2f, 0.1f}, weights[2] = {2.0f, 0.5f};
  double weighed[2];
  index.weigh(poses, log_scales, 2, scan, weights, 2, 0.2, 20.0, 1, weighed);
  double expected = 0.0;
  for (int p = 0; p < 2; ++p) {
    const double s[3] = {1.5 * scan[3 * p], 1.5 * scan[3 * p + 1], 1.5 * scan[3 * p + 2]};
    const double moved[3] = {-s[1] + 0.1, s[0] + 0.2, s[2] - 0.1};
    expected += weights[p] * std::log(0.8 * room.density(moved) + 0.2 / 20.0);
  }
  CHECK(std::abs(weighed[0] - expected) < 2.0 * tolerance * 2.5);
}

// The fast exponential, through a component evaluated near its mean.
void test_component_density(const monoloc::Kernels& kernels) {
  const Room room(20);
  const std::size_t stride = monoloc::kPadding;
  std::vector<float> offsets(3 * stride), density(stride), sum(stride, 1.0f);
  for (std::size_t i = 0; i < offsets.size(); ++i) offsets[i] = 0.01f * static_cast<float>(i % 7);
  kernels.component_density(room.components[0], room.means.data(), offsets.data(), stride, density.data(),
                            sum.data());
  double worst = 0.0;
  for (std::size_t i = 0; i < stride; ++i) {
    double x[3];
    for (std::size_t axis = 0; axis < 3; ++axis) x[axis] = room.means[axis] + offsets[axis * stride + i];
    worst = std::max(worst, std::abs(density[i] / room.density(0, x) - 1.0));
  }
  CHECK(worst < 1e-5);
}

// The errors that simd.hpp states: of the exponential, as the density of a component without extent.
void test_exponential(const monoloc::Kernels& kernels) {
  const std::size_t stride = monoloc::kPadding;
  const std::vector<float> offsets(3 * stride, 0.0f);
  std::vector<float> density(stride), sum(stride);
  const double corner[3] = {};
  double worst = 0.0;
  for (float t = -125.0f; t < 126.5f; t += 0.00137f) {
    monoloc::Component flat{};
    flat.log2_peak = static_cast<double>(t);
    kernels.component_density(flat, corner, offsets.data(), stride, density.data(), sum.data());
    worst = std::max(worst, std::abs(density[0] / std::exp2(static_cast<double>(t)) - 1.0));
  }
  CHECK(worst < 2.5e-7);
}

// Of the logarithm, as the weight of a point outside the map, which is that of an outlier.
void test_logarithm(const monoloc::Kernels& kernels) {
  const Room room(1);
  const monoloc::MixtureIndex index(room.components, {0.1, 0.01, 0.02});
  const std::size_t stride = monoloc::kPadding;
  const std::vector<float> particles(12 * stride, 1e6f), scan(3, 0.0f);
  std::vector<double> weighed(stride);
  double worst = 0.0;
  for (float x = 1e-37f; x < 1e37f; x *= 1.00131f) {
    kernels.weigh(index.view(), particles.data(), stride, 0, stride, scan.data(), nullptr, 1, 1.0f, x, weighed.data());
    const double exact = std::log(static_cast<double>(x));
    worst = std::max(worst, std::abs(weighed[0] - exact) / std::max(1.0, std::abs(exact)));
  }
  CHECK(worst < 2e-7);
}

// What the selection of components is made of, against plain loops.
void test_selection(const monoloc::Kernels& kernels) {
  const std::size_t stride = 3 * monoloc::kPadding;
  std::vector<float> values(stride), total(stride), sums(stride, 0.25f);
  for (std::size_t i = 0; i < stride; ++i) {
    values[i] = static_cast<float>(i * 7 % stride);
    total[i] = 2.0f + static_cast<float>(i % 3);
  }
  const std::vector<float> before = values;
  const float most = kernels.divide(values.data(), total.data(), stride);
  float expected = 0.0f, expected_sum = 0.0f;
  for (std::size_t i = 0; i < stride; ++i) {
    CHECK(std::abs(values[i] - before[i] / total[i]) < 1e-5f);
    expected = std::max(expected, values[i]);
    expected_sum = std::max(expected_sum, values[i] + sums[i]);
  }
  CHECK(most == expected);
  CHECK(kernels.largest_sum(values.data(), sums.data(), stride) == expected_sum);
}

// Many particles by one thread and by several, which is the same to the last bit; and pools asked for more and less.
void test_threads() {
  const Room room(60);
  const monoloc::MixtureIndex index(room.components, {0.1, 0.01, 0.02});
  const std::size_t count = 1000, points = 50;
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal(0.0, 0.1);
  std::vector<double> poses(16 * count, 0.0), log_scales(count), alone(count), shared(count);
  std::vector<float> scan(3 * points);
  for (std::size_t n = 0; n < count; ++n) {
    for (const std::size_t diagonal : {0, 5, 10, 15}) poses[16 * n + diagonal] = 1.0;
    for (const std::size_t axis : {3, 7, 11}) poses[16 * n + axis] = normal(random);
    log_scales[n] = normal(random);
  }
  for (std::size_t i = 0; i < scan.size(); ++i) scan[i] = static_cast<float>(room.means[i % room.means.size()]);
  index.weigh(poses.data(), log_scales.data(), count, scan.data(), nullptr, points, 0.2, 20.0, 1, alone.data());
  for (const std::size_t threads : {2, 5, 3, 64}) {
    for (int round = 0; round < 50; ++round) {
      shared.assign(count, 0.0);
      index.weigh(poses.data(), log_scales.data(), count, scan.data(), nullptr, points, 0.2, 20.0, threads,
                  shared.data());
      CHECK(shared == alone);
    }
  }
}

// Log-densities of exact kernels; the weighing kernel's result for one particle at the identity, exactly the
// sum of logarithms of the indexed density.
void test_kernels(const monoloc::Kernels& kernels) {
  const std::size_t components = 50, count = 64, stride = monoloc::kPadding;
  const Room room(components);
  const std::vector<double> x = room.points(count, 0.1);
  std::vector<double> rows(3 * count), valid(count, 1.0), scratch(components * monoloc::kPadding), result(count);
  std::vector<float> scan(3 * count), density(count), particles(12 * stride, 0.0f);
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      rows[axis * count + i] = x[3 * i + axis];
      scan[axis * count + i] = static_cast<float>(x[3 * i + axis]);
    }
  }
  double exact_log = 0.0;
  kernels.log_density(room.components.data(), components, rows.data(), count, scratch.data(), result.data());
  for (std::size_t i = 0; i < count; ++i) {
    CHECK(std::abs(result[i] - std::log(room.density(&x[3 * i]))) < 1e-11);
    exact_log += result[i];
  }
  std::vector<double> sums(components * 10 * monoloc::kPadding, 0.0), largest(count), relative(count);
  std::vector<std::uint32_t> active(components);
  kernels.expectation(room.components.data(), components, rows.data(), valid.data(), count, scratch.data(),
                      active.data(), sums.data(), largest.data(), relative.data());
  double total_log = 0.0;
  for (std::size_t i = 0; i < count; ++i) total_log += std::log(2.0) * largest[i] + std::log(relative[i]);
  CHECK(std::abs(total_log - exact_log) < 1e-9);

  const monoloc::MixtureIndex index(room.components, {0.1, 0.01, 0.02});
  kernels.density(index.view(), scan.data(), count, density.data());
  double expected = 0.0;
  for (std::size_t i = 0; i < count; ++i) expected += std::log(0.75 * static_cast<double>(density[i]) + 0.01);
  for (std::size_t n = 0; n < stride; ++n) {
    for (const std::size_t diagonal : {0, 4, 8}) particles[diagonal * stride + n] = 1.0f;
  }
  std::vector<double> weighed(stride);
  kernels.weigh(index.view(), particles.data(), stride, 0, stride, scan.data(), nullptr, count, 0.75f, 0.01f, weighed.data());
  for (const double w : weighed) CHECK(std::abs(w - expected) < 1e-4);
}

// Where a ray from the origin along r cuts a component: depth, precision, and the density there.
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

// log((1 - eps) d p(d | ray) + eps / range) of a point before a camera that is not turned.
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

// Every kernel of the weighing along rays: offsets, the choice of components, and the weights, at kRayBatch cameras
// that are not turned and stand 3 m before the room.
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
  bool all_chosen_that_matter = true;
  for (std::size_t p = 0; p < points; ++p) {
    candidates.resize(first[p] + components + 1);
    const std::size_t count = kernels.ray_candidates(view, particles.data(), offsets.data(), stride, scan[p],
                                                     scan[points + p], least, masses.data(), &candidates[first[p]]);
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
  CHECK(first[points] < points * components);  // and something was left out

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

// The whole way: particles far apart and close together, by one thread and by several.
void test_ray_mixture() {
  const Room room(40);
  const monoloc::RayMixture rays(room.components);
  const monoloc::RayNoise noise{0.05, 0.3, 4.0};
  const std::size_t count = 150, points = 20;
  std::mt19937_64 random(5);
  for (const double spread : {0.01, 2.0}) {
    std::uniform_real_distribution<double> place(-spread, spread), side(-0.3, 0.3);
    std::vector<double> poses(16 * count, 0.0), log_scales(count), alone(count), shared(count);
    std::vector<float> scan(3 * points);
    for (std::size_t n = 0; n < count; ++n) {
      for (const std::size_t diagonal : {0, 5, 10, 15}) poses[16 * n + diagonal] = 1.0;
      for (const std::size_t axis : {3, 7, 11}) poses[16 * n + axis] = place(random) - (axis == 11 ? 3.5 : 0.0);
      log_scales[n] = 0.1 * side(random);
    }
    for (std::size_t i = 0; i < scan.size(); ++i) {
      scan[i] = static_cast<float>((i % 3 == 2 ? 3.0 : 0.0) + side(random));
    }
    rays.weigh(poses.data(), log_scales.data(), count, scan.data(), nullptr, points, noise, 1, alone.data());
    double worst = 0.0;
    for (std::size_t n = 0; n < count; ++n) {
      const double origin[3] = {poses[16 * n + 3], poses[16 * n + 7], poses[16 * n + 11]}, s = std::exp(log_scales[n]);
      double expected = 0.0;
      for (std::size_t p = 0; p < points; ++p) {
        const double point[3] = {s * scan[3 * p], s * scan[3 * p + 1], s * scan[3 * p + 2]};
        expected += log_along_ray(room, origin, point, 0.05, 0.7, 0.3 / 4.0);
      }
      worst = std::max(worst, std::abs(alone[n] - expected));
    }
    CHECK(worst < 1e-3 * static_cast<double>(points));
    for (const std::size_t threads : {2, 5, 64}) {
      shared.assign(count, 0.0);
      rays.weigh(poses.data(), log_scales.data(), count, scan.data(), nullptr, points, noise, threads, shared.data());
      CHECK(shared == alone);
    }
  }
}

}  // namespace

int main() {
  test_whitening();
  test_rejects_indefinite();
  test_log_density_and_expectation();
  test_index();
  test_threads();
  test_ray_mixture();
  for (const monoloc::Kernels* const* k = monoloc::available_kernels(); *k != nullptr; ++k) {
    std::printf("%s\n", (*k)->name);
    test_component_density(**k);
    test_exponential(**k);
    test_logarithm(**k);
    test_selection(**k);
    test_kernels(**k);
    test_rays(**k);
  }
  if (failures == 0) std::printf("all passed\n");
  return failures == 0 ? 0 : 1;
}
