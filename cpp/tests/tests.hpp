// All tests, grouped by file.
#pragma once

#include "monoloc/kernels.hpp"

void test_whitening();
void test_rejects_indefinite();
void test_log_density_and_expectation();
void test_index();
void test_component_density(const monoloc::Kernels& kernels);
void test_exponential(const monoloc::Kernels& kernels);
void test_logarithm(const monoloc::Kernels& kernels);
void test_selection(const monoloc::Kernels& kernels);
void test_pool();
void test_kernels(const monoloc::Kernels& kernels);
void test_rays(const monoloc::Kernels& kernels);
void test_ray_mixture();
void test_pool_block(const monoloc::Kernels& kernels);
void test_pooling();
void test_drawing();
void test_matching();
void test_landmark_consensus();
void test_landmark_pose();
void test_gram(const monoloc::Kernels& kernels);
void test_nearest_descriptors();
void test_similar_descriptors(const monoloc::Kernels& kernels);
void test_window();
