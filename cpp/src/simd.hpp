// SIMD vectors by the compiler's vector extension (GCC, Clang) or lane by lane (MSVC), with fast exp2 and log. Only for
// kernels.cpp: everything has internal linkage, because it is compiled for several instruction sets.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#if defined(__AVX2__)
#include <immintrin.h>
#elif defined(__ARM_NEON) && defined(__aarch64__) && !defined(MONOLOC_LANES)
#include <arm_neon.h>
#define MONOLOC_NEON
#endif

#if defined(__GNUC__) || defined(__clang__)
#define MONOLOC_INLINE static inline __attribute__((always_inline))
#define MONOLOC_INLINE_MEMBER inline __attribute__((always_inline))
#define MONOLOC_INLINE_LAMBDA __attribute__((always_inline))
#define MONOLOC_UNLIKELY(condition) __builtin_expect(condition, 0)
#else
#define MONOLOC_INLINE static __forceinline
#define MONOLOC_INLINE_MEMBER __forceinline
#define MONOLOC_INLINE_LAMBDA
#define MONOLOC_UNLIKELY(condition) (condition)
#define MONOLOC_LANES  // tests define it for the other compilers too
#endif

#ifdef MONOLOC_LANES
#include "lanes.hpp"
#define MONOLOC_VECTOR(T, bytes, name) using name = Lanes<T, (bytes) / sizeof(T)>
#else
#define MONOLOC_VECTOR(T, bytes, name) typedef T name __attribute__((vector_size(bytes)))
#endif

namespace monoloc {
namespace {

#if defined(__AVX512F__)
#define MONOLOC_VECTOR_BYTES 64
#elif defined(__AVX2__)
#define MONOLOC_VECTOR_BYTES 32
#else
#define MONOLOC_VECTOR_BYTES 16
#endif

MONOLOC_VECTOR(float, 32, F8);
MONOLOC_VECTOR(std::int32_t, 32, I8);
MONOLOC_VECTOR(std::uint32_t, 32, U8);
MONOLOC_VECTOR(float, MONOLOC_VECTOR_BYTES, FW);
MONOLOC_VECTOR(std::int32_t, MONOLOC_VECTOR_BYTES, IW);
MONOLOC_VECTOR(std::uint32_t, MONOLOC_VECTOR_BYTES, UW);
MONOLOC_VECTOR(double, MONOLOC_VECTOR_BYTES, DW);
MONOLOC_VECTOR(std::int64_t, MONOLOC_VECTOR_BYTES, LW);
MONOLOC_VECTOR(std::uint64_t, MONOLOC_VECTOR_BYTES, ULW);

constexpr std::size_t kWide = sizeof(FW) / sizeof(float);
constexpr std::size_t kWide64 = sizeof(DW) / sizeof(double);

template <class V, class T>
MONOLOC_INLINE V load(const T* from) {
  V v;
  std::memcpy(&v, from, sizeof(V));
  return v;
}

template <class V, class T>
MONOLOC_INLINE void store(T* to, V v) {
  std::memcpy(to, &v, sizeof(V));
}

template <class To, class From>
MONOLOC_INLINE To bits(From from) {
  static_assert(sizeof(To) == sizeof(From), "same size");
  To to;
  std::memcpy(&to, &from, sizeof(To));
  return to;
}

template <class V, class T>
MONOLOC_INLINE V splat(T value) {
  return value - V{};
}

// Of a where the mask is true, else of b.
template <class M, class V>
MONOLOC_INLINE V choose(M mask, V a, V b) {
#ifdef MONOLOC_LANES
  for (std::size_t i = 0; i < sizeof(V) / sizeof(a[0]); ++i) a[i] = mask[i] ? a[i] : b[i];
  return a;
#else
  return mask ? a : b;
#endif
}

template <class V>
MONOLOC_INLINE V larger(V a, V b) {
  return choose(a > b, a, b);
}

// Each lane to another type of the same size, towards zero.
template <class To, class From>
MONOLOC_INLINE To convert(From from) {
#ifdef MONOLOC_LANES
  To to;
  for (std::size_t i = 0; i < sizeof(To) / sizeof(to[0]); ++i) to[i] = static_cast<decltype(to[0] + 0)>(from[i]);
  return to;
#else
  return __builtin_convertvector(from, To);
#endif
}

// 2^t, relative error below 2.5e-7. t below -125 gives 2^-125 (2.4e-38); t must be below 127.
// Splits t = n + f with |f| <= 1/2. A minimax polynomial of degree 5 gives 2^f, and n is added to the exponent bits,
// as unsigned numbers, whose overflow is defined.
template <class F, class U>
MONOLOC_INLINE F exp2_fast(F t) {
  t = larger(t, splat<F>(-125.0f));
  const F shifted = t + 12582912.0f;  // 1.5 * 2^23: rounds to an integer in the low bits
  const F f = t - (shifted - 12582912.0f);
  F p = f * 0.0013276472631950876f + 0.0096755413431213274f;
  p = p * f + 0.055507132718556443f;
  p = p * f + 0.24022119722710720f;
  p = p * f + 0.69314696706503522f;
  p = p * f + 1.0000000716547141f;
  return bits<F>(bits<U>(p) + (bits<U>(shifted) << 23));
}

// Natural logarithm, absolute or relative error below 2e-7, whichever is larger; x must be positive and normal.
// Cephes logf: x = 2^e m with sqrt(1/2) <= m < sqrt(2), polynomial in m - 1.
template <class F, class I>
MONOLOC_INLINE F log_fast(F x) {
  const I raw = bits<I>(x);
  const I exponent = (raw - 0x3F3504F3) >> 23;
  const F f = bits<F>(raw - exponent * (1 << 23)) - 1.0f;
  F p = f * 7.0376836292e-2f - 1.1514610310e-1f;
  p = p * f + 1.1676998740e-1f;
  p = p * f - 1.2420140846e-1f;
  p = p * f + 1.4249322787e-1f;
  p = p * f - 1.6668057665e-1f;
  p = p * f + 2.0000714765e-1f;
  p = p * f - 2.4999993993e-1f;
  p = p * f + 3.3333331174e-1f;
  const F f2 = f * f;
  const F e = convert<F>(exponent);
  return f2 * f * p + (e * -2.12194440e-4f - 0.5f * f2) + f + e * 0.693359375f;
}

// 2^t in double precision, relative error below 1e-15. t below -1000 gives 2^-1000; t must be below 1000.
MONOLOC_INLINE DW exp2_exact(DW t) {
  t = larger(t, splat<DW>(-1000.0));
  const DW shifted = t + 6755399441055744.0;  // 1.5 * 2^52
  const DW f = t - (shifted - 6755399441055744.0);
  DW p = f * 4.4352827069572771511e-10 + 7.0741056135082427963e-9;
  p = p * f + 1.0178198021671930844e-7;
  p = p * f + 1.321543308967639918e-6;
  p = p * f + 0.000015252733489988525649;
  p = p * f + 0.00015403530462514432062;
  p = p * f + 0.0013333558146789921722;
  p = p * f + 0.0096181291075883352443;
  p = p * f + 0.055504108664819921605;
  p = p * f + 0.24022650695910156204;
  p = p * f + 0.69314718055994533046;
  p = p * f + 0.9999999999999999971;
  return bits<DW>(bits<ULW>(p) + (bits<ULW>(shifted) << 52));
}

// Whether a > b in any lane.
MONOLOC_INLINE bool any_greater(DW a, DW b) {
#if defined(__AVX512F__)
  return _mm512_cmp_pd_mask(bits<__m512d>(a), bits<__m512d>(b), _CMP_GT_OQ) != 0;
#elif defined(__AVX2__)
  return _mm256_movemask_pd(_mm256_cmp_pd(bits<__m256d>(a), bits<__m256d>(b), _CMP_GT_OQ)) != 0;
#else
  const LW greater = a > b;
  return (greater[0] | greater[1]) != 0;
#endif
}

// Blocks of components are evaluated at kTogether points at once, with eight lanes of an FB per point. join fills the
// lanes, and sum_parts sums the lanes of each point.
#if defined(__AVX512F__)
typedef FW FB;
typedef UW UB;
MONOLOC_INLINE FB join(const F8* parts) {
  return bits<FB>(_mm512_insertf32x8(_mm512_castps256_ps512(bits<__m256>(parts[0])), bits<__m256>(parts[1]), 1));
}
MONOLOC_INLINE void sum_parts(FB v, float* sums) {
  __m512 s = bits<__m512>(v);
  s = _mm512_add_ps(s, _mm512_shuffle_f32x4(s, s, 0xB1));  // adds neighbouring quarters, then pairs, then lanes
  s = _mm512_add_ps(s, _mm512_permute_ps(s, 0x4E));
  s = _mm512_add_ps(s, _mm512_permute_ps(s, 0xB1));
  sums[0] = _mm512_cvtss_f32(s);
  sums[1] = _mm_cvtss_f32(_mm512_extractf32x4_ps(s, 2));
}
#else
typedef F8 FB;
typedef U8 UB;
MONOLOC_INLINE FB join(const F8* part) { return part[0]; }
MONOLOC_INLINE void sum_parts(FB v, float* sum) {
  MONOLOC_VECTOR(float, 16, F4);
  F4 half[2];
  std::memcpy(half, &v, sizeof(v));
  const F4 s = half[0] + half[1];
  sum[0] = (s[0] + s[1]) + (s[2] + s[3]);
}
#endif
constexpr std::size_t kTogether = sizeof(FB) / sizeof(F8);

}  // namespace
}  // namespace monoloc
