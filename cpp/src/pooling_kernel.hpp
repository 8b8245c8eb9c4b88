// Max-pooling of a block of channels, and chains of it; part of kernels.cpp, see there.
#pragma once

#include <cstddef>
#include <cstdint>

#include "monoloc/kernels.hpp"
#include "simd.hpp"

namespace monoloc {
namespace {

// A pixel of a block in vectors that the processor has: GCC takes larger ones apart, lane by lane.
#if MONOLOC_VECTOR_BYTES == 16
typedef FW FP;
typedef IW IP;
#else
typedef F8 FP;
typedef I8 IP;
#endif
constexpr std::size_t kPoolWide = sizeof(FP) / sizeof(float);
static_assert(kPoolLanes % kPoolWide == 0, "whole vectors");

// The pixels of a row or a column of a block, beginning at `first`. Pixels beyond an end are that end again, which
// changes neither a maximum nor its place.
template <bool with_places>
struct Line {
  const float* values;
  const std::int32_t* places;  // if null, each pixel's own number
  std::size_t first, step, count;
  std::size_t lane;  // first of a vector

  MONOLOC_INLINE_MEMBER std::size_t pixel(std::size_t k) const { return first + (k < count ? k : count - 1) * step; }
  MONOLOC_INLINE_MEMBER std::size_t at(std::size_t k) const { return pixel(k) * kPoolLanes + lane; }
  MONOLOC_INLINE_MEMBER FP value(std::size_t k) const { return load<FP>(values + at(k)); }
  MONOLOC_INLINE_MEMBER IP place(std::size_t k) const {
    if (!with_places) return IP{};
    if (places == nullptr) return splat<IP>(static_cast<std::int32_t>(pixel(k)));
    return load<IP>(places + at(k));
  }
};

// Maximum over five pixels around each one of a line. The five are kept, so that each pixel is read once.
template <bool with_places>
MONOLOC_INLINE void pool_line(const Line<with_places>& line, float* largest, std::int32_t* from) {
  FP a = line.value(0), b = a, c = a, d = line.value(1), e = line.value(2);
  IP at_a = line.place(0), at_b = at_a, at_c = at_a, at_d = line.place(1), at_e = line.place(2);
  for (std::size_t k = 0; k < line.count; ++k) {
    FP best = a;
    IP at = at_a;
    const auto compare = [&best, &at](FP value, IP place) MONOLOC_INLINE_LAMBDA {
      const IP is_larger = value > best;
      best = choose(is_larger, value, best);
      if (with_places) at = choose(is_larger, place, at);
    };
    compare(b, at_b);
    compare(c, at_c);
    compare(d, at_d);
    compare(e, at_e);
    store(largest + line.at(k), best);
    if (with_places) store(from + line.at(k), at);
    a = b, b = c, c = d, d = e, e = line.value(k + 3);
    at_a = at_b, at_b = at_c, at_c = at_d, at_d = at_e, at_e = line.place(k + 3);
  }
}

// The maximum over five rows of the maxima over five columns. The first of equal maxima is the one that a search row by
// row finds first.
template <bool with_places>
MONOLOC_INLINE void pool(const float* values, std::size_t rows, std::size_t columns, float* largest, std::int32_t* from,
                         float* along, std::int32_t* along_from) {
  for (std::size_t lane = 0; lane < kPoolLanes; lane += kPoolWide) {
    for (std::size_t row = 0; row < rows; ++row) {
      pool_line(Line<with_places>{values, nullptr, row * columns, 1, columns, lane}, along, along_from);
    }
    for (std::size_t column = 0; column < columns; ++column) {
      pool_line(Line<with_places>{along, along_from, column, columns, rows, lane}, largest, from);
    }
  }
}

void pool_block(const float* values, std::size_t rows, std::size_t columns, float* largest, std::int32_t* from,
                float* along, std::int32_t* along_from) {
  if (from == nullptr) {
    pool<false>(values, rows, columns, largest, from, along, along_from);
  } else {
    pool<true>(values, rows, columns, largest, from, along, along_from);
  }
}

constexpr float kMostOfChain = 6.0f;  // ReLU6

// `pooled` times its weight: the path to the next stage, and added to the sum.
MONOLOC_INLINE void add_stage(const float* pooled, const float* weights, std::size_t count, float* path, float* sum) {
  for (std::size_t lane = 0; lane < kPoolLanes; lane += kPoolWide) {
    const FP weight = load<FP>(weights + lane);
    for (std::size_t i = lane; i < count; i += kPoolLanes) {
      const FP next = weight * load<FP>(pooled + i);
      store(path + i, next);
      store(sum + i, load<FP>(sum + i) + next);
    }
  }
}

void chain_block(const float* values, std::size_t rows, std::size_t columns, const float* weights, std::size_t stages,
                 float* scratch, float* out) {
  const std::size_t count = rows * columns * kPoolLanes;
  float *along = scratch, *pooled = scratch + count, *path = scratch + 2 * count;
  for (std::size_t i = 0; i < count; ++i) out[i] = values[i];
  for (std::size_t stage = 0; stage < stages; ++stage) {
    pool<false>(stage == 0 ? values : path, rows, columns, pooled, nullptr, along, nullptr);
    add_stage(pooled, weights + stage * kPoolLanes, count, path, out);
  }
  const FP zero{}, most = splat<FP>(kMostOfChain);
  for (std::size_t lane = 0; lane < kPoolLanes; lane += kPoolWide) {
    const FP weight = load<FP>(weights + stages * kPoolLanes + lane);
    for (std::size_t i = lane; i < count; i += kPoolLanes) {
      const FP value = weight * load<FP>(out + i);
      // In this order a NaN stays.
      store(out + i, choose(value < zero, zero, choose(value > most, most, value)));
    }
  }
}

void chain_gradient_block(const float* values, const float* gradient, std::size_t rows, std::size_t columns,
                          const float* weights, std::size_t stages, float* scratch, std::int32_t* places, float* out,
                          float* of_weights) {
  const std::size_t count = rows * columns * kPoolLanes;
  float *along = scratch, *path = scratch + count, *sum = scratch + 2 * count, *of_sum = scratch + 3 * count;
  float* pooled = scratch + 4 * count;  // of every stage
  std::int32_t *along_from = places, *from = places + count;
  for (std::size_t i = 0; i < count; ++i) sum[i] = values[i];
  for (std::size_t stage = 0; stage < stages; ++stage) {
    float* largest = pooled + stage * count;
    pool<true>(stage == 0 ? values : path, rows, columns, largest, from + stage * count, along, along_from);
    add_stage(largest, weights + stage * kPoolLanes, count, path, sum);
  }
  // Through ReLU6 and the last weight: `of_sum` is the gradient of the sum, and of the last stage's addend.
  const FP zero{}, most = splat<FP>(kMostOfChain);
  for (std::size_t lane = 0; lane < kPoolLanes; lane += kPoolWide) {
    const FP last = load<FP>(weights + stages * kPoolLanes + lane);
    FP of_last{};
    for (std::size_t i = lane; i < count; i += kPoolLanes) {
      const FP unbounded = last * load<FP>(sum + i);
      const FP passed = choose((unbounded > zero) & (unbounded < most), load<FP>(gradient + i), zero);
      of_last += passed * load<FP>(sum + i);
      store(of_sum + i, last * passed);
      store(out + i, last * passed);
    }
    store(of_weights + stages * kPoolLanes + lane, of_last);
  }
  for (std::size_t stage = stages; stage-- > 0;) {
    const float* largest = pooled + stage * count;
    const std::int32_t* pixel = from + stage * count;
    for (std::size_t lane = 0; lane < kPoolLanes; lane += kPoolWide) {
      const FP weight = load<FP>(weights + stage * kPoolLanes + lane);
      FP of_weight{};
      for (std::size_t i = lane; i < count; i += kPoolLanes) {
        const FP of_addend = load<FP>(out + i);
        of_weight += of_addend * load<FP>(largest + i);
        store(path + i, weight * of_addend);
      }
      store(of_weights + stage * kPoolLanes + lane, of_weight);
    }
    for (std::size_t i = 0; i < count; ++i) out[i] = of_sum[i];
    for (std::size_t i = 0; i < count; i += kPoolLanes) {
      for (std::size_t lane = 0; lane < kPoolLanes; ++lane) {
        out[static_cast<std::size_t>(pixel[i + lane]) * kPoolLanes + lane] += path[i + lane];
      }
    }
  }
}

}  // namespace
}  // namespace monoloc
