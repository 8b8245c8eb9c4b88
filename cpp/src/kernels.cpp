// The hot loops. Compiled once for each instruction set, with MONOLOC_ISA as its name.
#include "monoloc/kernels.hpp"

#include <cmath>

#include "gram_kernel.hpp"
#include "hamming_kernel.hpp"
#include "pooling_kernel.hpp"
#include "ray_kernel.hpp"
#include "simd.hpp"
#include "window_kernel.hpp"

#define MONOLOC_JOIN_(a, b) a##b
#define MONOLOC_JOIN(a, b) MONOLOC_JOIN_(a, b)
#define MONOLOC_TEXT_(a) #a
#define MONOLOC_TEXT(a) MONOLOC_TEXT_(a)

namespace monoloc {
namespace {

constexpr std::size_t kBatch = 64;  // points per lookup batch, so that cache misses of the table overlap
static_assert(kBatch % kPadding == 0 && kPadding % kWide == 0 && kPadding % kWide64 == 0, "whole vectors");

constexpr std::size_t kMostItems = 255 * kBatch + 2;  // a list has at most 255 blocks

// Unit of evaluation: a block of components at a point of the batch.
struct Item {
  std::uint32_t block, point;
};

// A batch of points. The extra element receives the padding of the last vector.
struct Batch {
  alignas(64) float x[kBatch + 1], y[kBatch + 1], z[kBatch + 1], density[kBatch + 1];
  alignas(64) std::uint32_t key[kBatch], slot[kBatch], voxel[kBatch];
  Item items[kMostItems];
};

// Computes brick key, first slot of the brick, and voxel within the brick, for kWide points.
MONOLOC_INLINE void locate(const IndexView& index, FW x, FW y, FW z, Batch& batch, std::size_t at) {
  const FW gx = (x - index.origin[0]) * index.voxels_per_m;
  const FW gy = (y - index.origin[1]) * index.voxels_per_m;
  const FW gz = (z - index.origin[2]) * index.voxels_per_m;
  const FW zero = splat<FW>(0.0f);
  const IW inside = (gx >= zero) & (gy >= zero) & (gz >= zero) &
                    (gx < splat<FW>(4.0f * static_cast<float>(index.bricks[0]))) &
                    (gy < splat<FW>(4.0f * static_cast<float>(index.bricks[1]))) &
                    (gz < splat<FW>(4.0f * static_cast<float>(index.bricks[2])));
  // Zero replaces coordinates outside the grid, whose conversion could overflow.
  const IW ix = convert<IW>(choose(inside, gx, zero));
  const IW iy = convert<IW>(choose(inside, gy, zero));
  const IW iz = convert<IW>(choose(inside, gz, zero));
  const IW brick = ((iz >> 2) * index.bricks[1] + (iy >> 2)) * index.bricks[0] + (ix >> 2);  // wraps as if unsigned
  const IW key = choose(inside, brick, splat<IW>(static_cast<std::int32_t>(kOutsideKey)));
  store(batch.key + at, key);
  store(batch.slot + at, (bits<UW>(key) * kHashFactor) >> index.hash_shift);
  store(batch.voxel + at, (iz & 3) << 4 | (iy & 3) << 2 | (ix & 3));
}

// Candidate list of a voxel, or 0 (no blocks). The only branch is for collisions, which are rare.
MONOLOC_INLINE std::uint32_t find_list(const IndexView& index, std::uint32_t key, std::uint32_t slot,
                                       std::uint32_t voxel) {
  while (MONOLOC_UNLIKELY(index.slots[slot].key != key) && index.slots[slot].key != kEmptyKey) {
    slot = (slot + 1) & index.slot_mask;
  }
  return index.lists[index.slots[slot].lists + voxel];
}

// Adds the density of one block of components to each of kTogether points.
MONOLOC_INLINE void evaluate(const IndexView& index, Batch& batch, std::size_t item) {
  const float* block[kTogether];
  F8 x[kTogether], y[kTogether], z[kTogether];
  float sum[kTogether];
  for (std::size_t i = 0; i < kTogether; ++i) {
    const std::uint32_t p = batch.items[item + i].point;
    block[i] = index.blocks + static_cast<std::size_t>(batch.items[item + i].block) * kBlockFloats;
    x[i] = splat<F8>(batch.x[p]);
    y[i] = splat<F8>(batch.y[p]);
    z[i] = splat<F8>(batch.z[p]);
  }
  const auto row = [&block](int r) MONOLOC_INLINE_LAMBDA {
    F8 parts[kTogether];
    for (std::size_t i = 0; i < kTogether; ++i) parts[i] = load<F8>(block[i] + r * kBlockLanes);
    return join(parts);
  };
  const FB xs = join(x), ys = join(y), zs = join(z);
  const FB y0 = row(0) * xs + row(6);
  const FB y1 = row(1) * xs + (row(2) * ys + row(7));
  const FB y2 = row(3) * xs + (row(4) * ys + (row(5) * zs + row(8)));
  sum_parts(exp2_fast<FB, UB>(row(9) - y0 * y0 - y1 * y1 - y2 * y2), sum);
  for (std::size_t i = 0; i < kTogether; ++i) batch.density[batch.items[item + i].point] += sum[i];
}

// Sums the candidates' densities at the points found; returns the number of evaluated blocks. Three separate loops,
// so that a branch misprediction does not wait for a lookup. Gathering items is branch-free for points with up to two
// blocks, which is the usual case.
MONOLOC_INLINE std::size_t evaluate_batch(const IndexView& index, Batch& batch, std::size_t count) {
  std::uint32_t list[kBatch];
  for (std::size_t i = 0; i < count; ++i) {
    list[i] = find_list(index, batch.key[i], batch.slot[i], batch.voxel[i]);
  }
  for (std::size_t i = 0; i < kBatch; ++i) batch.density[i] = 0.0f;
  Item* next = batch.items;
  for (std::uint32_t i = 0; i < count; ++i) {
    const std::uint32_t first = list[i] >> 8, blocks = list[i] & 0xFF;
    next[0] = {first, i};
    next[1] = {first + 1, i};
    for (std::uint32_t b = 2; MONOLOC_UNLIKELY(b < blocks); ++b) next[b] = {first + b, i};
    next += blocks;
  }
  const auto items = static_cast<std::size_t>(next - batch.items);
  next[0] = {0, kBatch};
  for (std::size_t i = 0; i < items; i += kTogether) evaluate(index, batch, i);
  return items;
}

// The inner loop is over particles: neighbouring particles map a scan point to neighbouring voxels, whose table
// entries and lists stay in the L1 cache.
void weigh(const IndexView& index, const float* particles, std::size_t stride, const float* scan,
           const float* point_weights, std::size_t points, float inlier_share, float outlier_density, double* out) {
  Batch batch;
  batch.x[kBatch] = batch.y[kBatch] = batch.z[kBatch] = batch.density[kBatch] = 0.0f;
  for (std::size_t first = 0; first < stride; first += kBatch) {
    const std::size_t count = stride - first < kBatch ? stride - first : kBatch;
    alignas(64) double total[kBatch] = {};
    for (std::size_t p = 0; p < points; ++p) {
      const float px = scan[p], py = scan[points + p], pz = scan[2 * points + p];
      for (std::size_t i = 0; i < count; i += kWide) {
        const float* from = particles + first + i;
        const auto row = [from, stride](int r) MONOLOC_INLINE_LAMBDA { return load<FW>(from + r * stride); };
        const FW x = row(0) * px + (row(1) * py + (row(2) * pz + row(9)));
        const FW y = row(3) * px + (row(4) * py + (row(5) * pz + row(10)));
        const FW z = row(6) * px + (row(7) * py + (row(8) * pz + row(11)));
        store(batch.x + i, x);
        store(batch.y + i, y);
        store(batch.z + i, z);
        locate(index, x, y, z, batch, i);
      }
      evaluate_batch(index, batch, count);
      const float weight = point_weights ? point_weights[p] : 1.0f;
      for (std::size_t i = 0; i < count; i += kWide) {
        const FW mixed = load<FW>(batch.density + i) * inlier_share + outlier_density;
        store(batch.density + i, log_fast<FW, IW>(mixed) * weight);
      }
      for (std::size_t i = 0; i < count; ++i) total[i] += static_cast<double>(batch.density[i]);
    }
    for (std::size_t i = 0; i < count; ++i) out[first + i] = total[i];
  }
}

std::size_t density(const IndexView& index, const float* points, std::size_t stride, float* out) {
  std::size_t evaluated = 0;
  Batch batch;
  batch.x[kBatch] = batch.y[kBatch] = batch.z[kBatch] = batch.density[kBatch] = 0.0f;
  for (std::size_t first = 0; first < stride; first += kBatch) {
    const std::size_t count = stride - first < kBatch ? stride - first : kBatch;
    for (std::size_t i = 0; i < count; i += kWide) {
      const FW x = load<FW>(points + first + i);
      const FW y = load<FW>(points + stride + first + i);
      const FW z = load<FW>(points + 2 * stride + first + i);
      store(batch.x + i, x);
      store(batch.y + i, y);
      store(batch.z + i, z);
      locate(index, x, y, z, batch, i);
    }
    evaluated += evaluate_batch(index, batch, count);
    for (std::size_t i = 0; i < count; ++i) out[first + i] = batch.density[i];
  }
  return evaluated;
}

void component_density(const Component& component, const double* corner, const float* offsets, std::size_t stride,
                       float* out, float* total) {
  const double* w = component.whiten;
  const double dx = corner[0] - component.mean[0];
  const double dy = corner[1] - component.mean[1];
  const double dz = corner[2] - component.mean[2];
  const float a0 = static_cast<float>(w[0]), a1 = static_cast<float>(w[1]), a2 = static_cast<float>(w[2]);
  const float a3 = static_cast<float>(w[3]), a4 = static_cast<float>(w[4]), a5 = static_cast<float>(w[5]);
  const float b0 = static_cast<float>(w[0] * dx);
  const float b1 = static_cast<float>(w[1] * dx + w[2] * dy);
  const float b2 = static_cast<float>(w[3] * dx + w[4] * dy + w[5] * dz);
  const float peak = static_cast<float>(component.log2_peak);
  for (std::size_t i = 0; i < stride; i += kWide) {
    const FW x = load<FW>(offsets + i);
    const FW y = load<FW>(offsets + stride + i);
    const FW z = load<FW>(offsets + 2 * stride + i);
    const FW y0 = x * a0 + b0;
    const FW y1 = x * a1 + (y * a2 + b1);
    const FW y2 = x * a3 + (y * a4 + (z * a5 + b2));
    const FW value = exp2_fast<FW, UW>(peak - y0 * y0 - y1 * y1 - y2 * y2);
    store(out + i, value);
    store(total + i, load<FW>(total + i) + value);
  }
}

float largest_lane(FW v) {
  float most = 0.0f;
  for (std::size_t lane = 0; lane < kWide; ++lane) most = v[lane] > most ? v[lane] : most;
  return most;
}

float divide(float* values, const float* total, std::size_t stride) {
  FW most = splat<FW>(0.0f);
  for (std::size_t i = 0; i < stride; i += kWide) {
    const FW share = load<FW>(values + i) / load<FW>(total + i);
    store(values + i, share);
    most = larger(most, share);
  }
  return largest_lane(most);
}

float largest_sum(const float* a, const float* b, std::size_t stride) {
  FW most = splat<FW>(0.0f);
  for (std::size_t i = 0; i < stride; i += kWide) most = larger(most, load<FW>(a + i) + load<FW>(b + i));
  return largest_lane(most);
}

struct Offset {
  DW x, y, z;
};

MONOLOC_INLINE Offset offset_from_mean(const Component& c, DW x, DW y, DW z) {
  return {x - c.mean[0], y - c.mean[1], z - c.mean[2]};
}

// Terms below 2^-60 of the largest are skipped; even 1e5 of them are below double precision.
constexpr double kNegligibleBits = 60.0;

// Writes log2 of each weighted component density at kWide64 points to `terms`; returns the largest.
MONOLOC_INLINE DW log2_terms(const Component* components, std::size_t count, DW x, DW y, DW z, double* terms) {
  DW largest = splat<DW>(-1e300);
  for (std::size_t k = 0; k < count; ++k) {
    const Component& c = components[k];
    const Offset d = offset_from_mean(c, x, y, z);
    const DW y0 = d.x * c.whiten[0];
    const DW y1 = d.x * c.whiten[1] + d.y * c.whiten[2];
    const DW y2 = d.x * c.whiten[3] + d.y * c.whiten[4] + d.z * c.whiten[5];
    const DW term = c.log2_peak - y0 * y0 - y1 * y1 - y2 * y2;
    store(terms + k * kWide64, term);
    largest = larger(largest, term);
  }
  return largest;
}

void log_density(const Component* components, std::size_t count, const double* points, std::size_t stride,
                 double* scratch, double* out) {
  for (std::size_t i = 0; i < stride; i += kWide64) {
    const DW x = load<DW>(points + i), y = load<DW>(points + stride + i), z = load<DW>(points + 2 * stride + i);
    const DW largest = log2_terms(components, count, x, y, z, scratch);
    const DW negligible = largest - kNegligibleBits;
    DW total = splat<DW>(0.0);
    for (std::size_t k = 0; k < count; ++k) {
      const DW term = load<DW>(scratch + k * kWide64);
      if (any_greater(term, negligible)) total += exp2_exact(term - largest);
    }
    for (std::size_t lane = 0; lane < kWide64; ++lane) {
      out[i + lane] = 0.69314718055994530942 * largest[lane] + std::log(total[lane]);
    }
  }
}

void expectation(const Component* components, std::size_t count, const double* points, const double* valid,
                 std::size_t stride, double* scratch, std::uint32_t* active, double* partial_sums,
                 double* log2_largest, double* relative_sum) {
  for (std::size_t i = 0; i < stride; i += kWide64) {
    const DW x = load<DW>(points + i), y = load<DW>(points + stride + i), z = load<DW>(points + 2 * stride + i);
    const DW largest = log2_terms(components, count, x, y, z, scratch);
    const DW negligible = largest - kNegligibleBits;
    DW total = splat<DW>(0.0);
    std::size_t active_count = 0;
    for (std::size_t k = 0; k < count; ++k) {
      const DW term = load<DW>(scratch + k * kWide64);
      if (any_greater(term, negligible)) {
        const DW relative = exp2_exact(term - largest);
        store(scratch + k * kWide64, relative);
        total += relative;
        active[active_count++] = static_cast<std::uint32_t>(k);
      }
    }
    store(log2_largest + i, largest);
    store(relative_sum + i, total);
    const DW share = load<DW>(valid + i) / total;
    for (std::size_t a = 0; a < active_count; ++a) {
      const std::size_t k = active[a];
      const DW r = load<DW>(scratch + k * kWide64) * share;
      const Offset d = offset_from_mean(components[k], x, y, z);
      const DW rx = r * d.x, ry = r * d.y, rz = r * d.z;
      const DW added[10] = {r, rx, ry, rz, rx * d.x, rx * d.y, rx * d.z, ry * d.y, ry * d.z, rz * d.z};
      double* sums = partial_sums + k * 10 * kPadding;
      for (int s = 0; s < 10; ++s) store(sums + s * kPadding, load<DW>(sums + s * kPadding) + added[s]);
    }
  }
}

double multiply_add(std::size_t rounds, float* out) {
  constexpr std::size_t kChains = 16;  // enough independent chains to hide the latency of an operation
  FW sums[kChains];
  for (std::size_t c = 0; c < kChains; ++c) sums[c] = splat<FW>(static_cast<float>(c));
  const FW factor = splat<FW>(0.999f), added = splat<FW>(0.001f);
  for (std::size_t r = 0; r < rounds; ++r) {
    for (std::size_t c = 0; c < kChains; ++c) sums[c] = sums[c] * factor + added;
  }
  for (std::size_t c = 1; c < kChains; ++c) sums[0] += sums[c];
  store(out, sums[0]);
  return 2.0 * static_cast<double>(kChains * kWide) * static_cast<double>(rounds);
}

}  // namespace

extern const Kernels MONOLOC_JOIN(kernels_, MONOLOC_ISA);
const Kernels MONOLOC_JOIN(kernels_, MONOLOC_ISA) = {
    MONOLOC_TEXT(MONOLOC_ISA), weigh, density, component_density, divide, largest_sum, log_density, expectation,
    ray_offsets, ray_shortlist, ray_candidates, weigh_rays, pool_block, chain_block, chain_gradient_block,
    linearise_window, add_gram, similar_descriptors, multiply_add};

}  // namespace monoloc
