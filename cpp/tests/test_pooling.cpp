// Max-pooling and its gradient, against plain loops.
#include <algorithm>
#include <cstdint>
#include <cstring>
#include <limits>
#include <vector>

#include "check.hpp"
#include "monoloc/pooling.hpp"
#include "tests.hpp"

namespace {

float to_float(std::uint16_t bits) {
  const std::uint32_t wide = static_cast<std::uint32_t>(bits) << 16;
  float value;
  std::memcpy(&value, &wide, sizeof value);
  return value;
}

// Integers from -8 to 8; bfloat16 represents them and their sums exactly.
std::vector<std::uint16_t> whole_numbers(std::size_t count) {
  std::vector<std::uint16_t> out(count);
  std::uint32_t state = 1;
  for (auto& bits : out) {
    state = state * 1664525u + 1013904223u;
    const auto value = static_cast<float>(static_cast<int>((state >> 16) % 17) - 8);
    std::uint32_t wide;
    std::memcpy(&wide, &value, sizeof wide);
    bits = static_cast<std::uint16_t>(wide >> 16);
  }
  return out;
}

}  // namespace

void test_keys(const monoloc::Kernels& kernels) {
  // Three pixels with all bfloat16 values except NaN, one channel per value.
  std::vector<std::uint16_t> numbers;
  for (std::uint32_t bits = 0; bits < 65536; ++bits) {
    const auto half = static_cast<std::uint16_t>(bits);
    if (to_float(half) == to_float(half)) numbers.push_back(half);
  }
  constexpr std::size_t kPixels = 3, kFirst = 40000;
  const std::size_t channels = numbers.size(), count = kPixels * channels;
  std::vector<std::uint16_t> values, back(count), pixels(count);
  for (std::size_t p = 0; p < kPixels; ++p) values.insert(values.end(), numbers.begin(), numbers.end());
  std::vector<std::int32_t> keys(count);
  kernels.to_keys(values.data(), kPixels, channels, kFirst, keys.data());
  kernels.from_keys(keys.data(), count, back.data(), pixels.data());
  for (std::size_t i = 0; i < count; ++i) {
    CHECK(to_float(back[i]) == to_float(values[i]) && back[i] != 0x8000u);
    CHECK(pixels[i] == kFirst + i / channels);
    const std::size_t j = (i + 7919) % count;
    const float a = to_float(values[i]), b = to_float(values[j]);
    CHECK((keys[i] > keys[j]) == (a > b || (a == b && pixels[i] < pixels[j])));
  }
}

void test_largest_of_five(const monoloc::Kernels& kernels) {
  constexpr std::size_t kCount = 37;
  std::vector<std::int32_t> values(5 * kCount), out(kCount);
  std::uint32_t state = 7;
  for (auto& value : values) value = static_cast<std::int32_t>(state = state * 1664525u + 1013904223u);
  const std::int32_t* rows[5];
  for (std::size_t r = 0; r < 5; ++r) rows[r] = values.data() + r * kCount;
  kernels.largest_of_five(rows, kCount, out.data());
  for (std::size_t i = 0; i < kCount; ++i) {
    std::int32_t largest = values[i];
    for (std::size_t r = 1; r < 5; ++r) largest = std::max(largest, rows[r][i]);
    CHECK(out[i] == largest);
  }
}

void test_pooling() {
  const monoloc::ImageShape shape{7, 3, 5};
  const std::size_t images = 3, count = images * shape.values();
  const std::vector<std::uint16_t> values = whole_numbers(count), gradient = whole_numbers(count);
  std::vector<std::uint16_t> largest(count), from(count), back(count);
  monoloc::max_pool(values.data(), images, shape, 2, largest.data(), from.data());
  monoloc::max_pool_gradient(gradient.data(), from.data(), images, shape, 2, back.data());
  std::vector<float> expected(count, 0.0f);
  for (std::size_t image = 0; image < images; ++image) {
    for (std::size_t pixel = 0; pixel < shape.pixels(); ++pixel) {
      for (std::size_t c = 0; c < shape.channels; ++c) {
        const auto row = static_cast<int>(pixel / shape.columns), column = static_cast<int>(pixel % shape.columns);
        const std::size_t at = image * shape.values() + c;
        float best = -std::numeric_limits<float>::infinity();
        std::size_t where = 0;
        for (int r = std::max(0, row - 2); r <= std::min(6, row + 2); ++r) {
          for (int s = std::max(0, column - 2); s <= std::min(2, column + 2); ++s) {
            const auto other = static_cast<std::size_t>(r * 3 + s);
            const float value = to_float(values[at + other * shape.channels]);
            if (value > best) best = value, where = other;
          }
        }
        const std::size_t i = at + pixel * shape.channels;
        CHECK(to_float(largest[i]) == best);
        CHECK(from[i] == where);
        expected[at + where * shape.channels] += to_float(gradient[i]);
      }
    }
  }
  for (std::size_t i = 0; i < count; ++i) CHECK(to_float(back[i]) == expected[i]);

  // Zeros of both signs are equal, so the first pixel wins.
  const std::uint16_t zeros[2] = {0x8000u, 0x0000u};
  monoloc::max_pool(zeros, 1, {1, 2, 1}, 1, largest.data(), from.data());
  CHECK(largest[0] == 0 && largest[1] == 0 && from[0] == 0 && from[1] == 0);
}
