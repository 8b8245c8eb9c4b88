#include "monoloc/kernels.hpp"

#if defined(MONOLOC_X86_64) && defined(_MSC_VER)
#include <immintrin.h>
#include <intrin.h>
#endif

namespace monoloc {

extern const Kernels MONOLOC_BASELINE;  // of the processors that all run
#ifdef MONOLOC_X86_64
extern const Kernels kernels_avx2;
extern const Kernels kernels_avx512;
#endif

namespace {

#ifdef MONOLOC_X86_64
struct Processor {
  bool avx2 = false, avx512 = false;
};

#ifdef _MSC_VER
// Bits of CPUID (Intel's manual, volume 2A, CPUID) and of XCR0 (volume 1, section 13.3): the system must keep the
// registers too.
Processor processor() {
  constexpr int kFma = 1 << 12, kXsave = 1 << 27, kAvx2 = 1 << 5;
  constexpr int kAvx512 = 1 << 16 | 1 << 17 | 1 << 30 | static_cast<int>(1u << 31);  // F, DQ, BW, VL
  int id[4];
  __cpuid(id, 0);
  if (id[0] < 7) return {};
  __cpuid(id, 1);
  if ((id[2] & (kFma | kXsave)) != (kFma | kXsave)) return {};
  const unsigned long long kept = _xgetbv(0);
  __cpuidex(id, 7, 0);
  const bool avx2 = (kept & 0x6) == 0x6 && (id[1] & kAvx2) != 0;
  return {avx2, avx2 && (kept & 0xE6) == 0xE6 && (id[1] & kAvx512) == kAvx512};
}
#else
Processor processor() {
  __builtin_cpu_init();
  const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  const bool avx512 = avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
                      __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw");
  return {avx2, avx512};
}
#endif
#endif

// Fastest first, terminated by nullptr.
struct Available {
  const Kernels* list[4] = {};

  Available() {
    int count = 0;
#ifdef MONOLOC_X86_64
    const Processor has = processor();
    if (has.avx512) list[count++] = &kernels_avx512;
    if (has.avx2) list[count++] = &kernels_avx2;
#endif
    list[count] = &MONOLOC_BASELINE;
  }
};

}  // namespace

const Kernels* const* available_kernels() {
  static const Available available;
  return available.list;
}

const Kernels& kernels() { return **available_kernels(); }

}  // namespace monoloc
