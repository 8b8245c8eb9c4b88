// Keys of bfloat16 values and their pixels, and the maximum of five; part of kernels.cpp, see there.
#pragma once

#include <cstddef>
#include <cstdint>

namespace monoloc {
namespace {

// Plain loops over contiguous integers, which the compiler vectorises.

constexpr std::uint16_t kNegativeZero = 0x8000u;

// Maps bits of a bfloat16 to an integer of the same order, by inverting all bits of negative numbers except the sign.
// The function is its own inverse.
std::uint16_t flipped(std::uint16_t bits) {
  return static_cast<std::uint16_t>(bits ^ ((static_cast<std::int16_t>(bits) >> 15) & 0x7FFF));
}

void to_keys(const std::uint16_t* values, std::size_t columns, std::size_t channels, std::size_t first_pixel,
             std::int32_t* keys) {
  for (std::size_t column = 0; column < columns; ++column) {
    const std::uint32_t place = 0xFFFFu - static_cast<std::uint32_t>(first_pixel + column);
    const std::uint16_t* given = values + column * channels;
    std::int32_t* out = keys + column * channels;
    for (std::size_t c = 0; c < channels; ++c) {
      const std::uint16_t bits = given[c] == kNegativeZero ? std::uint16_t{0} : given[c];  // equal to zero
      out[c] = static_cast<std::int32_t>((static_cast<std::uint32_t>(flipped(bits)) << 16) | place);
    }
  }
}

void from_keys(const std::int32_t* keys, std::size_t count, std::uint16_t* values, std::uint16_t* pixels) {
  for (std::size_t i = 0; i < count; ++i) {
    const auto key = static_cast<std::uint32_t>(keys[i]);
    values[i] = flipped(static_cast<std::uint16_t>(key >> 16));
    pixels[i] = static_cast<std::uint16_t>(0xFFFFu - (key & 0xFFFFu));
  }
}

void largest_of_five(const std::int32_t* const* rows, std::size_t count, std::int32_t* out) {
  const std::int32_t *a = rows[0], *b = rows[1], *c = rows[2], *d = rows[3], *e = rows[4];
  for (std::size_t i = 0; i < count; ++i) {
    const std::int32_t ab = a[i] > b[i] ? a[i] : b[i];
    const std::int32_t cd = c[i] > d[i] ? c[i] : d[i];
    const std::int32_t abcd = ab > cd ? ab : cd;
    out[i] = abcd > e[i] ? abcd : e[i];
  }
}

}  // namespace
}  // namespace monoloc
