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

#ifdef __AVX512BW__
// Ones in each half of 16 bytes of two descriptors, of which `one` is both.
MONOLOC_INLINE __m512i differing_halves(__m512i one, const std::uint64_t* others) {
  // Of the numbers of 4 bits (Mula et al., Faster Population Counts Using AVX2 Instructions, 2018).
  const __m512i ones = _mm512_broadcast_i32x4(_mm_setr_epi8(0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4));
  const __m512i low = _mm512_set1_epi8(0x0F);
  const __m512i x = _mm512_xor_si512(one, _mm512_loadu_si512(others));
  const __m512i bytes =
      _mm512_add_epi8(_mm512_shuffle_epi8(ones, _mm512_and_si512(x, low)),
                      _mm512_shuffle_epi8(ones, _mm512_and_si512(_mm512_srli_epi16(x, 4), low)));
  return _mm512_sad_epu8(bytes, _mm512_setzero_si512());
}

// Sums of the neighbours in each half of two registers, of one and the other in turn.
MONOLOC_INLINE __m512i add_neighbours(__m512i a, __m512i b) {
  return _mm512_add_epi64(_mm512_unpacklo_epi64(a, b), _mm512_unpackhi_epi64(a, b));
}

// Differing bits of eight descriptors, one after the other.
MONOLOC_INLINE __m512i differing_of_eight(__m512i one, const std::uint64_t* others) {
  constexpr std::size_t two = 2 * kDescriptorWords;
  __m512i pairs[4];
  for (std::size_t i = 0; i < 4; ++i) pairs[i] = differing_halves(one, others + two * i);
  const __m512i first = add_neighbours(pairs[0], pairs[1]), second = add_neighbours(pairs[2], pairs[3]);
  // Of descriptors 0, 2, 1, 3, 4, 6, 5, 7.
  const __m512i sums = _mm512_add_epi64(_mm512_shuffle_i64x2(first, second, 0x88),
                                        _mm512_shuffle_i64x2(first, second, 0xDD));
  return _mm512_permutexvar_epi64(_mm512_setr_epi64(0, 2, 1, 3, 4, 6, 5, 7), sums);
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
#ifdef __AVX512BW__
  const __m512i one = _mm512_broadcast_i64x4(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(descriptor)));
  const __m512i most = _mm512_set1_epi64(limit);
  for (; first + 8 <= count; first += 8) {
    const __m512i eight = differing_of_eight(one, others + kDescriptorWords * first);
    const __mmask8 similar = _mm512_cmplt_epu64_mask(eight, most);
    if (similar == 0) continue;
    std::uint32_t each[8];
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(each), _mm512_cvtepi64_epi32(eight));
    for (std::size_t i = 0; i < 8; ++i) keep(first + i, each[i]);
  }
#endif
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
