// The components that matter in each voxel, brick by brick.
#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "monoloc/index.hpp"
#include "monoloc/rigid_motion.hpp"
#include "select.hpp"

namespace monoloc {

inline std::size_t blocks_of(std::size_t components) { return (components + kBlockLanes - 1) / kBlockLanes; }

// Region where a component can matter: the ellipsoid |W d| <= radius about its mean, and its bounding box.
struct Reach {
  std::uint32_t component;
  double radius;
  double lower[3], upper[3];
};

// Grid of bricks. The key of a brick is its index, x fastest, then y, then z.
struct Grid {
  double lower[3];
  double brick_m;
  std::uint32_t bricks[3];

  std::uint32_t key(std::uint32_t x, std::uint32_t y, std::uint32_t z) const {
    return (z * bricks[1] + y) * bricks[0] + x;
  }
  void corner(std::uint32_t key, double* out) const {
    const std::uint32_t at[3] = {key % bricks[0], key / bricks[0] % bricks[1], key / bricks[0] / bricks[1]};
    for (int axis = 0; axis < 3; ++axis) out[axis] = lower[axis] + at[axis] * brick_m;
  }
};

constexpr std::size_t kNoList = static_cast<std::size_t>(-1);

// What is stored of a brick: the lists of its voxels, which share lists.
struct BrickLists {
  std::uint32_t key = 0;
  std::vector<List> lists;
  std::vector<std::size_t> list_of_voxel;  // index in `lists`, or kNoList
  std::size_t voxels = 0, components = 0;  // voxels that have a list, and components of these before they share
};

// Buffers of a thread, which go from brick to brick.
struct BrickBuffers {
  Selector selector;
  std::vector<List> voxels = std::vector<List>(kBrickVoxels);
};

// The bricks of a mixture. Different bricks can be computed at once.
class Bricks {
 public:
  // Throws std::invalid_argument if the grid would need more than 2^32 bricks.
  Bricks(const std::vector<Component>& mixture, const IndexSettings& settings);

  const Grid& grid() const { return grid_; }
  std::size_t size() const { return firsts_.size() - 1; }

  // Lists of the i-th brick, in the order of keys.
  BrickLists lists(std::size_t i, BrickBuffers& buffers) const;

 private:
  // Writes the components that may matter in each voxel of the i-th brick, x fastest, then y, then z.
  void find_candidates(std::size_t i, std::vector<List>& found) const;

  const std::vector<Component>& mixture_;
  double voxel_m_;
  std::vector<Reach> reached_;
  Grid grid_;
  std::vector<Vec3> spans_;  // of each whitened coordinate of a component in a voxel, from its value at the centre
  std::vector<std::pair<std::uint32_t, std::uint32_t>> near_;  // (brick key, index in `reached_`), sorted
  std::vector<std::size_t> firsts_;                            // in `near_`, of each brick, and its end
};

}  // namespace monoloc
