// Hamming distances of binary descriptors; part of kernels.cpp, see there.
#pragma once

#include "monoloc/kernels.hpp"
#include "simd.hpp"

namespace monoloc {
namespace {

#if defined(__POPCNT__)
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

#ifdef MONOLOC_NEON
MONOLOC_INLINE uint8x16x2_t load_bytes(const std::uint64_t* descriptor) {
  const auto* bytes = reinterpret_cast<const std::uint8_t*>(descriptor);
  return {{vld1q_u8(bytes), vld1q_u8(bytes + 16)}};
}

// Ones in each byte, of both halves of a descriptor together.
MONOLOC_INLINE uint8x16_t differing_bytes(const uint8x16x2_t& one, const std::uint64_t* other) {
  const uint8x16x2_t its = load_bytes(other);
  return vaddq_u8(vcntq_u8(veorq_u8(one.val[0], its.val[0])), vcntq_u8(veorq_u8(one.val[1], its.val[1])));
}

// Differing bits of four descriptors, one after the other, and whether any has fewer than a limit.
MONOLOC_INLINE bool differing_of_four(const uint8x16x2_t& one, const std::uint64_t* others, std::uint32_t limit,
                                      std::uint32_t* bits) {
  uint8x16_t each[4];
  for (std::size_t i = 0; i < 4; ++i) each[i] = differing_bytes(one, others + kDescriptorWords * i);
  const uint8x16_t quarters = vpaddq_u8(vpaddq_u8(each[0], each[1]), vpaddq_u8(each[2], each[3]));
  const uint32x4_t sums = vpaddlq_u16(vpaddlq_u8(quarters));
  vst1q_u32(bits, sums);
  return vminvq_u32(sums) < limit;
}
#endif

std::size_t similar_descriptors(const std::uint64_t* descriptor, const std::uint64_t* others, std::size_t count,
                                std::uint32_t limit, std::uint32_t* places, std::uint32_t* bits) {
  std::size_t found = 0, first = 0;
  const auto keep = [&](std::size_t place, std::uint32_t differing) MONOLOC_INLINE_LAMBDA {
    if (differing >= limit) return;
    places[found] = static_cast<std::uint32_t>(place);
    bits[found++] = differing;
  };
#ifdef MONOLOC_NEON
  const uint8x16x2_t one = load_bytes(descriptor);
  for (; first + 4 <= count; first += 4) {
    std::uint32_t four[4];
    if (!differing_of_four(one, others + kDescriptorWords * first, limit, four)) continue;
    for (std::size_t i = 0; i < 4; ++i) keep(first + i, four[i]);
  }
#endif
  for (; first < count; ++first) keep(first, differing(descriptor, others + kDescriptorWords * first));
  return found;
}

}  // namespace
}  // namespace monoloc
