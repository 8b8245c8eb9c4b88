// Compares all kernels that this processor supports with plain loops in double precision.
#include <cstdio>

#include "check.hpp"
#include "monoloc/kernels.hpp"
#include "tests.hpp"

int main() {
  test_whitening();
  test_rejects_indefinite();
  test_log_density_and_expectation();
  test_index();
  test_pool();
  test_ray_mixture();
  test_pooling();
  test_drawing();
  test_matching();
  test_nearest_descriptors();
  test_landmark_consensus();
  test_landmark_pose();
  test_window();
  for (const monoloc::Kernels* const* k = monoloc::available_kernels(); *k != nullptr; ++k) {
    std::printf("%s\n", (*k)->name);
    test_component_density(**k);
    test_exponential(**k);
    test_logarithm(**k);
    test_selection(**k);
    test_kernels(**k);
    test_rays(**k);
    test_pool_block(**k);
    test_gram(**k);
    test_similar_descriptors(**k);
  }
  if (failures == 0) std::printf("all passed\n");
  return failures == 0 ? 0 : 1;
}
