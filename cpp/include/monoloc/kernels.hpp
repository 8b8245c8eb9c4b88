// The hot loops, compiled once for each instruction set. Plain pointers only: no inline function of the
// standard library may be compiled for an instruction set that the linker could then hand to everyone.
#pragma once

#include <cstddef>
#include <cstdint>

namespace monoloc {

// One component of a mixture, ready to be evaluated: with d = x - mean,
//   y = whiten * d (lower triangular), log2(weight * density(x)) = log2_peak - |y|^2.
// whiten is L^-1 of covariance = L L^T, times sqrt(log2(e) / 2), so that base-2 exponentials serve.
struct Component {
  double whiten[6];  // rows: (0), (1, 2), (3, 4, 5)
  double mean[3];
  double log2_peak;
};

constexpr std::size_t kBlockLanes = 8;                 // components evaluated together
constexpr std::size_t kBlockFloats = 10 * kBlockLanes;  // a block: 10 parameters of 8 components, each contiguous
constexpr std::size_t kPadding = 16;                   // arrays of lanes are padded to a multiple of this
constexpr std::uint32_t kEmptyKey = 0xFFFFFFFFu;       // key of a free slot
constexpr std::uint32_t kOutsideKey = 0xFFFFFFFEu;     // key of a point outside the grid; never stored
constexpr std::uint32_t kHashFactor = 0x9E3779B1u;     // 2^32 / golden ratio (Knuth's multiplicative hash)

// An entry of the hash table: a voxel and its candidate list, packed as (first block << 8) | blocks.
struct Slot {
  std::uint32_t key;
  std::uint32_t list;
};

struct IndexView {
  float origin[3];
  float voxels_per_m;
  std::int32_t shape[3];
  std::uint32_t hash_shift;  // slot = (key * kHashFactor) >> hash_shift
  std::uint32_t slot_mask;
  const Slot* slots;
  const float* blocks;
};

struct Kernels {
  const char* name;

  // sum_p w_p log(inlier_share M(A_n x_p + t_n) + outlier_density). particles: 12 rows (A row-major, then t)
  // of `stride` floats, padded; scan: 3 rows of `points` floats; out: `stride` doubles.
  void (*weigh)(const IndexView& index, const float* particles, std::size_t stride, const float* scan,
                const float* point_weights, std::size_t points, float inlier_share, float outlier_density,
                double* out);

  // Density of the indexed mixture at centred points: 3 rows of `stride` floats, padded; 0 outside the voxels.
  void (*density)(const IndexView& index, const float* points, std::size_t stride, float* out);

  // weight * density of one component at offsets (3 rows of `stride` floats, padded) from a corner in its frame.
  void (*component_density)(const Component& component, const double* corner, const float* offsets,
                            std::size_t stride, float* out);

  // Log-density (natural) at points: 3 rows of `stride` doubles, padded. scratch: components * kPadding doubles.
  void (*log_density)(const Component* components, std::size_t count, const double* points, std::size_t stride,
                      double* scratch, double* out);

  // Adds the E-step's statistics: 10 values a component (mass, first 3, second 6), each kPadding partial sums.
  // valid: 1 for a point, 0 for padding. scratch as above, active: `count` integers. out: total density a point
  // as (base-2 logarithm of the largest term, sum of terms relative to it).
  void (*expectation)(const Component* components, std::size_t count, const double* points, const double* valid,
                      std::size_t stride, double* scratch, std::uint32_t* active, double* partial_sums,
                      double* log2_largest, double* relative_sum);
};

// The fastest kernels this processor runs.
const Kernels& kernels();

// All kernels this processor runs, for tests: ends with nullptr.
const Kernels* const* available_kernels();

}  // namespace monoloc
