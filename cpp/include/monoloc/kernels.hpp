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
constexpr std::uint32_t kBrickEdge = 4;  // voxels along a brick, which has one entry in the hash table
constexpr std::uint32_t kBrickVoxels = kBrickEdge * kBrickEdge * kBrickEdge;
constexpr std::uint32_t kEmptyKey = 0xFFFFFFFFu;        // key of a free slot
constexpr std::uint32_t kOutsideKey = 0xFFFFFFFEu;      // key of a point outside the grid; never stored
constexpr std::uint32_t kHashFactor = 0x9E3779B1u;      // 2^32 / golden ratio (Knuth's multiplicative hash)

// An entry of the hash table: a brick and where its voxels' lists begin; those of free slots, at 0, are empty.
struct Slot {
  std::uint32_t key;
  std::uint32_t lists;
};

struct IndexView {
  float origin[3];
  float voxels_per_m;
  std::int32_t bricks[3];    // along each axis of the grid
  std::uint32_t hash_shift;  // slot = (key * kHashFactor) >> hash_shift
  std::uint32_t slot_mask;
  const Slot* slots;
  const std::uint32_t* lists;  // kBrickVoxels of each brick, packed as (first block << 8) | blocks; 0 for none
  const float* blocks;
};

constexpr std::size_t kRayBatch = 64;    // particles whose rays are followed together
constexpr float kNearest = 0.05f;        // metres; a component whose nearest point on the ray comes before is not seen

// A mixture for rays: `whiten` and `log2_peak` as in Component, means centred.
struct RayView {
  const float* whiten;  // 6 a component
  const float* means;   // 3 a component
  const float* log2_peak;
  std::size_t components;
};

struct Kernels {
  const char* name;

  // sum_p w_p log(inlier_share M(A_n x_p + t_n) + outlier_density) for particles first <= n < last, both multiples of
  // kPadding. particles: 12 rows (A row-major, then t) of `stride` floats, padded; scan: 3 rows of `points` floats;
  // out: `stride` doubles.
  void (*weigh)(const IndexView& index, const float* particles, std::size_t stride, std::size_t first,
                std::size_t last, const float* scan, const float* point_weights, std::size_t points,
                float inlier_share, float outlier_density, double* out);

  // Density of the indexed mixture at centred points: 3 rows of `stride` floats, padded; 0 outside the voxels.
  // Returns how many blocks of components it evaluated.
  std::size_t (*density)(const IndexView& index, const float* points, std::size_t stride, float* out);

  // weight * density of one component at offsets (3 rows of `stride` floats, padded) from a corner in its frame;
  // `total` grows by it.
  void (*component_density)(const Component& component, const double* corner, const float* offsets,
                            std::size_t stride, float* out, float* total);

  // Divides `values` by `total`, element by element (`stride` floats, padded), and returns the largest quotient.
  float (*divide)(float* values, const float* total, std::size_t stride);

  // The largest a + b of `stride` padded floats, none negative.
  float (*largest_sum)(const float* a, const float* b, std::size_t stride);

  // Log-density (natural) at points: 3 rows of `stride` doubles, padded. scratch: components * kPadding doubles.
  void (*log_density)(const Component* components, std::size_t count, const double* points, std::size_t stride,
                      double* scratch, double* out);

  // Adds the E-step's statistics: 10 values a component (mass, first 3, second 6), each kPadding partial sums.
  // valid: 1 for a point, 0 for padding. scratch as above, active: `count` integers. out: total density a point
  // as (base-2 logarithm of the largest term, sum of terms relative to it).
  void (*expectation)(const Component* components, std::size_t count, const double* points, const double* valid,
                      std::size_t stride, double* scratch, std::uint32_t* active, double* partial_sums,
                      double* log2_largest, double* relative_sum);

  // whiten * (mean - o) of every component (3 rows of `stride` floats each) for origins o (3 rows), padded.
  void (*ray_offsets)(const RayView& view, const float* centres, std::size_t stride, float* out);

  // Components that, at any of `stride` <= kRayBatch cameras, carry more than 2^least of what the fullest one
  // carries along the camera's ray (x, y, 1). rotations: 9 rows; offsets as above; scratch: a row a component.
  // out: room for one more than there are components. Returns their number.
  std::size_t (*ray_candidates)(const RayView& view, const float* rotations, const float* offsets,
                                std::size_t stride, float x, float y, float least, float* scratch,
                                std::uint32_t* out);

  // sum_p w_p log p(log d_p | ray) of kRayBatch particles. particles: 10 rows (rotation, scale); scan: x / z, y / z, z
  // (3 rows of `points`); candidates of point p: from first_candidate[p] up to first_candidate[p + 1]; scratch:
  // 3 kPadding floats a component; out: kRayBatch doubles.
  void (*weigh_rays)(const RayView& view, const float* particles, const float* offsets, const float* scan,
                     const float* point_weights, std::size_t points, const std::uint32_t* candidates,
                     const std::size_t* first_candidate, float log_depth_sd, float inlier_share,
                     float outlier_density, float* scratch, double* out);

  // A row's values, bfloat16 as its bits, as keys: the value in the upper half, as an integer of the same order, and
  // the pixel in the lower, so that of equal values the first pixel has the largest key. One maximum then finds both.
  void (*to_keys)(const std::uint16_t* values, std::size_t columns, std::size_t channels, std::size_t first_pixel,
                  std::int32_t* keys);

  // The values of keys, and the pixels that have them.
  void (*from_keys)(const std::int32_t* keys, std::size_t count, std::uint16_t* values, std::uint16_t* pixels);

  // The largest of five rows' keys, element by element.
  void (*largest_of_five)(const std::int32_t* const* rows, std::size_t count, std::int32_t* out);

  // Multiplies and adds as fast as the processor can, `rounds` times, for benchmarks to be held against; returns the
  // operations done. out: kPadding floats, so that the work is not left out.
  double (*multiply_add)(std::size_t rounds, float* out);
};

// The fastest kernels this processor runs.
const Kernels& kernels();

// All kernels this processor runs, for tests: ends with nullptr.
const Kernels* const* available_kernels();

}  // namespace monoloc
