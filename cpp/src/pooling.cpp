#include "monoloc/pooling.hpp"

#include <algorithm>
#include <cstring>
#include <limits>
#include <vector>

#include "monoloc/kernels.hpp"
#include "pool.hpp"

namespace monoloc {
namespace {

constexpr std::size_t kReach = 2;  // pixels on each side
constexpr std::int32_t kLeast = std::numeric_limits<std::int32_t>::min();

float to_float(std::uint16_t bits) {
  const std::uint32_t wide = static_cast<std::uint32_t>(bits) << 16;
  float value;
  std::memcpy(&value, &wide, sizeof value);
  return value;
}

// Rounds to nearest, ties to even.
std::uint16_t to_bfloat16(float value) {
  std::uint32_t wide;
  std::memcpy(&wide, &value, sizeof wide);
  return static_cast<std::uint16_t>((wide + 0x7FFFu + ((wide >> 16) & 1u)) >> 16);
}

void pool_image(const std::uint16_t* values, const ImageShape& shape, std::uint16_t* largest, std::uint16_t* from) {
  const std::size_t row = shape.columns * shape.channels, margin = kReach * shape.channels;
  // One row of keys with a margin on both sides, and the horizontal maxima of the last five rows. This working set
  // fits in the cache.
  constexpr std::size_t kRows = 2 * kReach + 1;
  std::vector<std::int32_t> keys(row + 2 * margin, kLeast), along(kRows * row, kLeast), both(row);
  const std::int32_t *shifted[kRows], *rows[kRows];
  for (std::size_t s = 0; s < kRows; ++s) shifted[s] = keys.data() + s * shape.channels;
  for (std::size_t s = 0; s < kRows; ++s) rows[s] = along.data() + s * row;
  for (std::size_t r = 0; r < shape.rows + kReach; ++r) {
    std::int32_t* latest = along.data() + r % kRows * row;
    if (r < shape.rows) {
      kernels().to_keys(values + r * row, shape.columns, shape.channels, r * shape.columns, keys.data() + margin);
      kernels().largest_of_five(shifted, row, latest);
    } else {
      std::fill_n(latest, row, kLeast);  // below the image
    }
    if (r < kReach) continue;
    kernels().largest_of_five(rows, row, both.data());
    const std::size_t at = (r - kReach) * row;
    kernels().from_keys(both.data(), row, largest + at, from + at);
  }
}

}  // namespace

void max_pool(const std::uint16_t* values, std::size_t images, const ImageShape& shape, std::size_t threads,
              std::uint16_t* largest, std::uint16_t* from) {
  run_on_threads(images, threads, [&](std::size_t image) {
    const std::size_t at = image * shape.values();
    pool_image(values + at, shape, largest + at, from + at);
  });
}

void max_pool_gradient(const std::uint16_t* gradient, const std::uint16_t* from, std::size_t images,
                       const ImageShape& shape, std::size_t threads, std::uint16_t* out) {
  run_on_threads(images, threads, [&](std::size_t image) {
    const std::size_t at = image * shape.values();
    std::vector<float> sums(shape.values(), 0.0f);
    for (std::size_t pixel = 0; pixel < shape.pixels(); ++pixel) {
      for (std::size_t c = 0; c < shape.channels; ++c) {
        const std::size_t i = at + pixel * shape.channels + c;
        sums[from[i] * shape.channels + c] += to_float(gradient[i]);
      }
    }
    for (std::size_t i = 0; i < sums.size(); ++i) out[at + i] = to_bfloat16(sums[i]);
  });
}

}  // namespace monoloc
