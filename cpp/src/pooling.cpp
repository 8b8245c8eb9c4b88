#include "monoloc/pooling.hpp"

#include <cstring>
#include <limits>
#include <vector>

#include "monoloc/kernels.hpp"
#include "pool.hpp"

namespace monoloc {
namespace {

constexpr std::size_t kReach = 2;  // pixels to either side
constexpr std::uint16_t kNegativeZero = 0x8000u;
constexpr std::int32_t kLeast = std::numeric_limits<std::int32_t>::min();

// The value in the upper half, as an integer of the same order, and the pixel in the lower: of equal values, the
// first pixel has the largest key. One maximum then finds both.
std::int32_t to_key(std::uint16_t bits, std::size_t pixel) {
  if (bits == kNegativeZero) bits = 0;  // which equals it
  const auto sign = static_cast<std::int16_t>(bits);
  const std::uint16_t ordered = sign < 0 ? static_cast<std::uint16_t>(bits ^ 0x7FFFu) : bits;
  const std::uint32_t place = 0xFFFFu - static_cast<std::uint32_t>(pixel);
  return static_cast<std::int32_t>((static_cast<std::uint32_t>(ordered) << 16) | place);
}

std::uint16_t to_bits(std::int32_t key) {
  const auto ordered = static_cast<std::uint16_t>(static_cast<std::uint32_t>(key) >> 16);
  return static_cast<std::int16_t>(ordered) < 0 ? static_cast<std::uint16_t>(ordered ^ 0x7FFFu) : ordered;
}

float to_float(std::uint16_t bits) {
  const std::uint32_t wide = static_cast<std::uint32_t>(bits) << 16;
  float value;
  std::memcpy(&value, &wide, sizeof value);
  return value;
}

// To the nearest, of two as near to the even one.
std::uint16_t to_bfloat16(float value) {
  std::uint32_t wide;
  std::memcpy(&wide, &value, sizeof wide);
  return static_cast<std::uint16_t>((wide + 0x7FFFu + ((wide >> 16) & 1u)) >> 16);
}

void pool_image(const std::uint16_t* values, const ImageShape& shape, std::uint16_t* largest, std::uint16_t* from) {
  const std::size_t row = shape.columns * shape.channels, margin = kReach * shape.channels;
  // One row of keys with a margin on both sides; what is largest along rows, with a margin above and below.
  std::vector<std::int32_t> keys(row + 2 * margin, kLeast);
  std::vector<std::int32_t> along((shape.rows + 2 * kReach) * row, kLeast), both(row);
  for (std::size_t r = 0; r < shape.rows; ++r) {
    const std::uint16_t* given = values + r * row;
    for (std::size_t column = 0; column < shape.columns; ++column) {
      const std::size_t at = column * shape.channels, pixel = r * shape.columns + column;
      for (std::size_t c = at; c < at + shape.channels; ++c) keys[margin + c] = to_key(given[c], pixel);
    }
    const std::int32_t* shifted[5];
    for (std::size_t s = 0; s < 5; ++s) shifted[s] = keys.data() + s * shape.channels;
    kernels().largest_of_five(shifted, row, along.data() + (r + kReach) * row);
  }
  for (std::size_t r = 0; r < shape.rows; ++r) {
    const std::int32_t* rows[5];
    for (std::size_t s = 0; s < 5; ++s) rows[s] = along.data() + (r + s) * row;
    kernels().largest_of_five(rows, row, both.data());
    for (std::size_t i = 0; i < row; ++i) {
      largest[r * row + i] = to_bits(both[i]);
      from[r * row + i] = static_cast<std::uint16_t>(0xFFFFu - (static_cast<std::uint32_t>(both[i]) & 0xFFFFu));
    }
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
