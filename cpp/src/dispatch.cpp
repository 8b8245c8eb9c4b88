#include "monoloc/kernels.hpp"

namespace monoloc {

extern const Kernels kernels_baseline;
#ifdef MONOLOC_X86_64
extern const Kernels kernels_avx2;
extern const Kernels kernels_avx512;
#endif

namespace {

// Fastest first, terminated by nullptr.
struct Available {
  const Kernels* list[4] = {};

  Available() {
    int count = 0;
#ifdef MONOLOC_X86_64
    __builtin_cpu_init();
    const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
    const bool avx512 = avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
                        __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw");
    if (avx512) list[count++] = &kernels_avx512;
    if (avx2) list[count++] = &kernels_avx2;
#endif
    list[count] = &kernels_baseline;
  }
};

}  // namespace

const Kernels* const* available_kernels() {
  static const Available available;
  return available.list;
}

const Kernels& kernels() { return **available_kernels(); }

}  // namespace monoloc
