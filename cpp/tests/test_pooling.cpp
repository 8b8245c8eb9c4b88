// Max-pooling, chains of it, and their gradients, against plain loops.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <vector>

#include "check.hpp"
#include "monoloc/pooling.hpp"
#include "tests.hpp"

namespace {

using Values = std::vector<double>;

constexpr monoloc::ImageShape kShape{7, 3, 21};  // two blocks of channels and a part of one
constexpr std::size_t kImages = 3, kCount = kImages * 7 * 3 * 21;

float to_float(float value) { return value; }

float to_float(std::uint16_t bits) {
  const std::uint32_t wide = static_cast<std::uint32_t>(bits) << 16;
  float value;
  std::memcpy(&value, &wide, sizeof value);
  return value;
}

void convert(double value, float& out) { out = static_cast<float>(value); }

// Exact for small integers.
void convert(double value, std::uint16_t& out) {
  const auto narrow = static_cast<float>(value);
  std::uint32_t wide;
  std::memcpy(&wide, &narrow, sizeof wide);
  out = static_cast<std::uint16_t>(wide >> 16);
}

// Integers from -8 to 8; bfloat16 represents them and their sums exactly.
Values whole_numbers(std::size_t count, std::uint32_t state = 1) {
  Values out(count);
  for (auto& value : out) {
    state = state * 1664525u + 1013904223u;
    value = static_cast<int>((state >> 16) % 17) - 8;
  }
  return out;
}

template <class T>
std::vector<T> narrow(const Values& values) {
  std::vector<T> out(values.size());
  for (std::size_t i = 0; i < values.size(); ++i) convert(values[i], out[i]);
  return out;
}

// Index of the first of the largest values around a value, in the same image and channel.
std::size_t largest_around(const Values& values, std::size_t i) {
  const std::size_t channel = i % kShape.channels, pixel = i / kShape.channels % kShape.pixels();
  const std::size_t start = i / kShape.values() * kShape.values() + channel;
  const auto row = static_cast<int>(pixel / kShape.columns), column = static_cast<int>(pixel % kShape.columns);
  std::size_t where = i;
  double best = -std::numeric_limits<double>::infinity();
  for (int r = std::max(0, row - 2); r <= std::min(6, row + 2); ++r) {
    for (int c = std::max(0, column - 2); c <= std::min(2, column + 2); ++c) {
      const std::size_t other = start + static_cast<std::size_t>(r * 3 + c) * kShape.channels;
      if (values[other] > best) best = values[other], where = other;
    }
  }
  return where;
}

template <class T>
void test_max_pool() {
  const Values values = whole_numbers(kCount), gradient = whole_numbers(kCount, 2);
  std::vector<T> largest(kCount), back(kCount);
  std::vector<std::uint16_t> from(kCount);
  monoloc::max_pool(narrow<T>(values).data(), kImages, kShape, 2, largest.data(), from.data());
  monoloc::max_pool_gradient(narrow<T>(gradient).data(), from.data(), kImages, kShape, 2, back.data());
  Values expected(kCount, 0.0);
  for (std::size_t i = 0; i < kCount; ++i) {
    const std::size_t where = largest_around(values, i);
    CHECK(to_float(largest[i]) == values[where]);
    CHECK(from[i] == where / kShape.channels % kShape.pixels());
    expected[where] += gradient[i];
  }
  for (std::size_t i = 0; i < kCount; ++i) CHECK(to_float(back[i]) == expected[i]);

  // Zeros of both signs are equal, so the first pixel wins.
  const T zeros[2] = {narrow<T>({-0.0})[0], narrow<T>({0.0})[0]};
  monoloc::max_pool(zeros, 1, {1, 2, 1}, 1, largest.data(), from.data());
  CHECK(to_float(largest[0]) == 0.0f && to_float(largest[1]) == 0.0f && from[0] == 0 && from[1] == 0);
}

// Weights that leave integers, so that equal maxima occur, and sums that are exact.
template <class T>
void test_chain(std::size_t stages) {
  const std::size_t channels = kShape.channels;
  const Values values = whole_numbers(kCount), gradient = whole_numbers(kCount, 2);
  Values weights = whole_numbers((stages + 1) * channels, 3);
  for (double& weight : weights) weight = weight > 0.0 ? 1.0 : -1.0;
  const auto weight = [&](std::size_t stage, std::size_t i) -> double& { return weights[stage * channels + i % channels]; };
  const std::vector<float> given_weights = narrow<float>(weights);

  Values sum = values, path = values, of_sum(kCount), of_weights(kImages * weights.size(), 0.0);
  std::vector<std::vector<std::size_t>> from(stages, std::vector<std::size_t>(kCount));
  std::vector<Values> pooled(stages, Values(kCount));
  for (std::size_t stage = 0; stage < stages; ++stage) {
    for (std::size_t i = 0; i < kCount; ++i) {
      from[stage][i] = largest_around(path, i);
      pooled[stage][i] = path[from[stage][i]];
    }
    for (std::size_t i = 0; i < kCount; ++i) {
      path[i] = weight(stage, i) * pooled[stage][i];
      sum[i] += path[i];
    }
  }
  std::vector<T> chained(kCount), back(kCount);
  monoloc::chain_pools(narrow<T>(values).data(), kImages, kShape, given_weights.data(), stages, 2, chained.data());
  const auto weight_at = [&](std::size_t stage, std::size_t i) -> double& {
    return of_weights[(i / kShape.values() * (stages + 1) + stage) * channels + i % channels];
  };
  for (std::size_t i = 0; i < kCount; ++i) {
    const double unbounded = weight(stages, i) * sum[i];
    CHECK(to_float(chained[i]) == std::min(6.0, std::max(0.0, unbounded)));
    const double passed = unbounded > 0.0 && unbounded < 6.0 ? gradient[i] : 0.0;
    weight_at(stages, i) += passed * sum[i];
    of_sum[i] = weight(stages, i) * passed;
  }
  Values of_path = of_sum;
  for (std::size_t stage = stages; stage-- > 0;) {
    Values before = of_sum;
    for (std::size_t i = 0; i < kCount; ++i) {
      weight_at(stage, i) += of_path[i] * pooled[stage][i];
      before[from[stage][i]] += weight(stage, i) * of_path[i];
    }
    of_path = before;
  }
  std::vector<float> of_given_weights(of_weights.size());
  monoloc::chain_pools_gradient(narrow<T>(values).data(), narrow<T>(gradient).data(), kImages, kShape,
                                given_weights.data(), stages, 2, back.data(), of_given_weights.data());
  const double rounding = sizeof(T) == 2 ? 1.0 / 256.0 : 1e-6;  // sums may pass the integers of bfloat16
  for (std::size_t i = 0; i < kCount; ++i) {
    CHECK(std::abs(to_float(back[i]) - of_path[i]) <= rounding * std::abs(of_path[i]));
  }
  for (std::size_t i = 0; i < of_weights.size(); ++i) CHECK(of_given_weights[i] == of_weights[i]);
}

}  // namespace

void test_pooling() {
  test_max_pool<float>();
  test_max_pool<std::uint16_t>();
  for (std::size_t stages : {0, 1, 4}) {
    test_chain<float>(stages);
    test_chain<std::uint16_t>(stages);
  }
}

// One pixel, and a block against the maximum without places.
void test_pool_block(const monoloc::Kernels& kernels) {
  constexpr std::size_t kRows = 6, kColumns = 4, kSize = kRows * kColumns * monoloc::kPoolLanes;
  const std::vector<float> values = narrow<float>(whole_numbers(kSize));
  std::vector<float> along(kSize), with(kSize), without(kSize);
  std::vector<std::int32_t> from(kSize), along_from(kSize);
  for (const std::size_t rows : {kRows, std::size_t{1}}) {
    const std::size_t columns = rows == 1 ? 1 : kColumns, size = rows * columns * monoloc::kPoolLanes;
    kernels.pool_block(values.data(), rows, columns, with.data(), from.data(), along.data(), along_from.data());
    kernels.pool_block(values.data(), rows, columns, without.data(), nullptr, along.data(), nullptr);
    for (std::size_t i = 0; i < size; ++i) {
      const std::size_t lane = i % monoloc::kPoolLanes;
      CHECK(with[i] == without[i] && with[i] >= values[i]);
      CHECK(with[i] == values[static_cast<std::size_t>(from[i]) * monoloc::kPoolLanes + lane]);
    }
  }
}
