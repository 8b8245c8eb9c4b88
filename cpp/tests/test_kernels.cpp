// Parts of the kernels, for each instruction set.
#include <cmath>
#include <cstdint>
#include <vector>

#include "check.hpp"
#include "monoloc/index.hpp"
#include "monoloc/kernels.hpp"
#include "room.hpp"
#include "tests.hpp"

// The fast exponential, by a component near its mean.
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

// Error bound of the exponential from simd.hpp, by a component of constant density.
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

// Error bound of the logarithm from simd.hpp, by the likelihood of a point outside the map, which is an outlier.
void test_logarithm(const monoloc::Kernels& kernels) {
  const Room room(1);
  const monoloc::MixtureIndex index(room.components, {0.1, 0.01, 0.02});
  const std::size_t stride = monoloc::kPadding;
  const std::vector<float> particles(12 * stride, 1e6f), scan(3, 0.0f);
  std::vector<double> weighed(stride);
  double worst = 0.0;
  for (float x = 1e-37f; x < 1e37f; x *= 1.00131f) {
    kernels.weigh(index.view(), particles.data(), stride, scan.data(), nullptr, 1, 1.0f, x, weighed.data());
    const double exact = std::log(static_cast<double>(x));
    worst = std::max(worst, std::abs(weighed[0] - exact) / std::max(1.0, std::abs(exact)));
  }
  CHECK(worst < 2e-7);
}

// Parts of the selection of components, against plain loops.
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

// Log-densities of the exact kernels, and the likelihood kernel for particles at the identity, which must equal the
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
  kernels.weigh(index.view(), particles.data(), stride, scan.data(), nullptr, count, 0.75f, 0.01f, weighed.data());
  for (const double w : weighed) CHECK(std::abs(w - expected) < 1e-4);
}
