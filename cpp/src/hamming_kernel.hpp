// Hamming distances of binary descriptors; part of kernels.cpp, see there.
#pragma once

#include "monoloc/kernels.hpp"
#include "simd.hpp"

namespace monoloc {
namespace {

#if defined(__POPCNT__) || defined(__aarch64__)
MONOLOC_INLINE std::uint32_t differing(const std::uint64_t* a, const std::uint64_t* b) {
  int ones = 0;
  for (std::size_t i = 0; i < kDescriptorWords; ++i) ones += __builtin_popcountll(a[i] ^ b[i]);
  return static_cast<std::uint32_t>(ones);
}
#else
// Ones are counted in fields of 2, 4 and 8 bits (Warren, Hacker's Delight, section 5-1), where no instruction counts
// them. The words' fields of 8 bits add up to at most 32, those of 16 bits to at most 256.
MONOLOC_INLINE std::uint32_t differing(const std::uint64_t* a, const std::uint64_t* b) {
  std::uint64_t bytes = 0;
  for (std::size_t i = 0; i < kDescriptorWords; ++i) {
    std::uint64_t x = a[i] ^ b[i];
    x -= (x >> 1) & 0x5555555555555555u;
    x = (x & 0x3333333333333333u) + ((x >> 2) & 0x3333333333333333u);
    bytes += (x + (x >> 4)) & 0x0F0F0F0F0F0F0F0Fu;
  }
  const std::uint64_t pairs = (bytes & 0x00FF00FF00FF00FFu) + ((bytes >> 8) & 0x00FF00FF00FF00FFu);
  return static_cast<std::uint32_t>((pairs * 0x0001000100010001u) >> 48);
}
#endif

void differing_bits(const std::uint64_t* descriptor, const std::uint64_t* others, const std::uint32_t* chosen,
                    std::size_t count, std::uint32_t* out) {
  for (std::size_t i = 0; i < count; ++i) out[i] = differing(descriptor, others + kDescriptorWords * chosen[i]);
}

}  // namespace
}  // namespace monoloc
