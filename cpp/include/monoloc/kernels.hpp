// The hot loops, compiled once for each instruction set. They use plain pointers only. An inline function of the
// standard library would be compiled for each instruction set, and the linker could use one version everywhere.
#pragma once

#include <cstddef>
#include <cstdint>

namespace monoloc {

// One component of a mixture, prepared for evaluation: with d = x - mean,
//   y = whiten * d (lower triangular), log2(weight * density(x)) = log2_peak - |y|^2.
// whiten is L^-1 of covariance = L L^T, times sqrt(log2(e) / 2), which makes the exponential base 2.
struct Component {
  double whiten[6];  // rows: (0), (1, 2), (3, 4, 5)
  double mean[3];
  double log2_peak;
};

constexpr std::size_t kBlockLanes = 8;                 // components per block
constexpr std::size_t kBlockFloats = 10 * kBlockLanes;  // a block has 10 parameters of 8 components, each contiguous
constexpr std::size_t kPadding = 16;                   // lane arrays are padded to a multiple of this
constexpr std::uint32_t kBrickEdge = 4;  // voxels along a brick; a brick is one entry of the hash table
constexpr std::uint32_t kBrickVoxels = kBrickEdge * kBrickEdge * kBrickEdge;
constexpr std::uint32_t kEmptyKey = 0xFFFFFFFFu;        // key of a free slot
constexpr std::uint32_t kOutsideKey = 0xFFFFFFFEu;      // key of a point outside the grid; never stored
constexpr std::uint32_t kHashFactor = 0x9E3779B1u;      // 2^32 / golden ratio (Knuth's multiplicative hash)

// Entry of the hash table: a brick, and the start of its voxels' lists. Free slots refer to empty lists at 0.
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
  const std::uint32_t* lists;  // kBrickVoxels per brick, packed as (first block << 8) | blocks; 0 for none
  const float* blocks;
};

constexpr double kWindowDamping = 1e-4;  // relative to the diagonal of a window's normal matrix; against rounding

// A window of keyframes that observe corners; rows of `stride` doubles, one for each corner, padded.
struct WindowView {
  const double* cameras;       // 12 per keyframe: rotation, row-major, and translation; camera from common frame
  const double* observations;  // 6 rows per keyframe: x and y at z = 1, log-depth; 1 where known; 0 where missing
  const double* points;        // 3 rows
  std::size_t frames, stride;
  double ray_scale, log_depth_scale;  // reciprocals of the standard deviations
};

constexpr std::size_t kPoseSums = 33;

// Normal equations of a window. Each point is eliminated: with L L^T its damped normal matrix, its three rows are L^-1
// times its products with the twists (rho, phi) of all keyframes but the first and, in the last column, its gradient.
struct WindowSums {
  double* poses;  // kPoseSums rows of kPadding partial sums per keyframe: blocks rho rho, rho phi and phi phi, gradient
  double* information;  // 6 rows: normal matrix of each point, by its rays alone: xx xy xz yy yz zz
  double* whiten;       // 6 rows: L^-1 of each point, lower triangle by rows
  double* rows;         // 3 rows per point; entries of keyframes that do not observe it stay as they are
  std::size_t row_stride;
  double* scratch;  // 12 * kPadding per keyframe
};

constexpr std::size_t kPoolLanes = 8;        // channels pooled at once
constexpr std::size_t kDescriptorWords = 4;  // of a binary descriptor of 256 bits
constexpr std::size_t kRayBatch = 64;    // particles per batch
constexpr float kNearest = 0.05f;        // metres; components nearer along the ray are ignored

// A mixture for rays: `whiten` and `log2_peak` as in Component, means relative to a centre.
struct RayView {
  const float* whiten;  // 6 per component
  const float* means;   // 3 per component
  const float* log2_peak;
  std::size_t components;
};

// The same mixture in rows of `stride` floats, padded by components without mass, and what a neighbouring ray may
// change: `norm` bounds |whiten x| / |x| from above and `least` from below.
struct ShortlistView {
  const float* whiten;   // 6 rows
  const float* offsets;  // 3 rows: whiten * (mean - o)
  const float* log2_peak;
  const float* norm;
  const float* least;
  const float* reach;  // |whiten * (mean - o)|
  std::size_t stride;
  float moved, turned;  // largest change of a ray's origin, metres, and of its direction
};

struct Kernels {
  const char* name;

  // sum_p w_p log(inlier_share M(A_n x_p + t_n) + outlier_density) of each particle n. particles: 12 rows (A row-major,
  // then t) of `stride` floats, padded; scan: 3 rows of `points` floats; out: `stride` doubles.
  void (*weigh)(const IndexView& index, const float* particles, std::size_t stride, const float* scan,
                const float* point_weights, std::size_t points, float inlier_share, float outlier_density,
                double* out);

  // Density of the indexed mixture at centred points: 3 rows of `stride` floats, padded; 0 outside the voxels.
  // Returns the number of evaluated blocks.
  std::size_t (*density)(const IndexView& index, const float* points, std::size_t stride, float* out);

  // weight * density of one component at offsets (3 rows of `stride` floats, padded) from a corner in its frame;
  // added to `total`.
  void (*component_density)(const Component& component, const double* corner, const float* offsets,
                            std::size_t stride, float* out, float* total);

  // Divides `values` by `total`, element by element (`stride` floats, padded), and returns the largest quotient.
  float (*divide)(float* values, const float* total, std::size_t stride);

  // Largest a + b of `stride` padded, non-negative floats.
  float (*largest_sum)(const float* a, const float* b, std::size_t stride);

  // Log-density (natural) at points: 3 rows of `stride` doubles, padded. scratch: components * kPadding doubles.
  void (*log_density)(const Component* components, std::size_t count, const double* points, std::size_t stride,
                      double* scratch, double* out);

  // Adds the E-step's statistics: 10 values per component (mass, first 3, second 6), each as kPadding partial sums.
  // valid: 1 for a point, 0 for padding. scratch: as above; active: `count` integers. The last two arguments receive
  // the total density of each point: base-2 logarithm of the largest term, and sum of terms relative to it.
  void (*expectation)(const Component* components, std::size_t count, const double* points, const double* valid,
                      std::size_t stride, double* scratch, std::uint32_t* active, double* partial_sums,
                      double* log2_largest, double* relative_sum);

  // whiten * (mean - o) of each component (3 rows of `stride` floats each) for origins o (3 rows), padded.
  void (*ray_offsets)(const RayView& view, const float* centres, std::size_t stride, float* out);

  // Components that may have more than 2^least of the largest component's mass along a ray (3) or along one of its
  // neighbours, so that only these need ray_candidates. scratch: one row; out: capacity of `stride` + 1. Returns their
  // number.
  std::size_t (*ray_shortlist)(const ShortlistView& view, const float* ray, float least, float* scratch,
                               std::uint32_t* out);

  // Components of a shortlist with more than 2^least of the largest one's mass along the ray (x, y, 1) of any of
  // `stride` <= kRayBatch cameras. rotations: 9 rows; offsets: as above; scratch: one row per component of the
  // shortlist; out: capacity of one more than the shortlist. Returns the number of selected components.
  std::size_t (*ray_candidates)(const RayView& view, const float* rotations, const float* offsets,
                                std::size_t stride, float x, float y, float least, const std::uint32_t* shortlist,
                                std::size_t count, float* scratch, std::uint32_t* out);

  // sum_p w_p log p(log d_p | ray) of kRayBatch particles. particles: 10 rows (rotation, scale); scan: 3 rows of
  // `points` (x / z, y / z, z); candidates of point p: from first_candidate[p] up to first_candidate[p + 1]; scratch:
  // 3 kPadding floats per component; out: kRayBatch doubles.
  void (*weigh_rays)(const RayView& view, const float* particles, const float* offsets, const float* scan,
                     const float* point_weights, std::size_t points, const std::uint32_t* candidates,
                     const std::size_t* first_candidate, float log_depth_sd, float inlier_share,
                     float outlier_density, float* scratch, double* out);

  // Maximum over the 5 x 5 pixels around each pixel of a block of kPoolLanes channels, and the number of its pixel (the
  // first of several; not written if null). All arrays have rows * columns * kPoolLanes elements; along, along_from:
  // scratch.
  void (*pool_block)(const float* values, std::size_t rows, std::size_t columns, float* largest, std::int32_t* from,
                     float* along, std::int32_t* along_from);

  // See chain_pools. weights: (stages + 1) rows of kPoolLanes; scratch: 3 blocks.
  void (*chain_block)(const float* values, std::size_t rows, std::size_t columns, const float* weights,
                      std::size_t stages, float* scratch, float* out);

  // Gradient of chain_block with respect to its values and weights, from that of its output. scratch: 4 + stages
  // blocks; places: 1 + stages blocks.
  void (*chain_gradient_block)(const float* values, const float* gradient, std::size_t rows, std::size_t columns,
                               const float* weights, std::size_t stages, float* scratch, std::int32_t* places,
                               float* out, float* of_weights);

  // Linearises the observations of kPadding corners from `first`: adds to the poses' sums, and writes the points'.
  void (*linearise_window)(const WindowView& view, std::size_t first, const WindowSums& sums);

  // Adds the products of columns, sum_k rows[k, i] rows[k, j], to the entries i <= j < columns of a matrix, and to some
  // of the other entries. rows: (count, columns), out: (columns, columns); each row begins `stride` doubles after the
  // last, and both are padded.
  void (*add_gram)(const double* rows, std::size_t count, std::size_t columns, std::size_t stride, double* out);

  // Which of `count` descriptors of kDescriptorWords, one after the other, differ from one in fewer than `limit` bits,
  // in order, and in how many. Both arrays have room for `count`. Returns their number.
  std::size_t (*similar_descriptors)(const std::uint64_t* descriptor, const std::uint64_t* others, std::size_t count,
                                     std::uint32_t limit, std::uint32_t* places, std::uint32_t* bits);

  // Multiplies and adds at peak speed, `rounds` times, as a reference for benchmarks. Returns the number of
  // operations. out: kPadding floats; writing them prevents the compiler from removing the work.
  double (*multiply_add)(std::size_t rounds, float* out);
};

// The fastest kernels that this processor supports.
const Kernels& kernels();

// All kernels that this processor supports, for tests; terminated by nullptr.
const Kernels* const* available_kernels();

}  // namespace monoloc
