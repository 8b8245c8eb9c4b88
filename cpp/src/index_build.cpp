// Construction of the index: voxels near the map, and the components that matter in each.
#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <stdexcept>
#include <string>
#include <unordered_map>
#include <utility>

#include "monoloc/index.hpp"
#include "select.hpp"

namespace monoloc {
namespace {

constexpr double kCandidateShare = 0.1;  // of the allowed error; components below it are not sampled
constexpr std::size_t kMaxBlocks = 255, kMaxFirstBlock = (1u << 24) - 1;  // limits of a packed list

double whitened_norm(const Component& c, const double* point) {
  const double* w = c.whiten;
  const double d[3] = {point[0] - c.mean[0], point[1] - c.mean[1], point[2] - c.mean[2]};
  const double y0 = w[0] * d[0];
  const double y1 = w[1] * d[0] + w[2] * d[1];
  const double y2 = w[3] * d[0] + w[4] * d[1] + w[5] * d[2];
  return std::sqrt(y0 * y0 + y1 * y1 + y2 * y2);
}

// Largest whitened distance from the centre of a cube to its surface, which occurs at a corner.
double whitened_reach(const Component& c, double half_edge) {
  double longest = 0.0;
  for (const double sy : {-half_edge, half_edge}) {
    for (const double sz : {-half_edge, half_edge}) {
      const double corner[3] = {c.mean[0] + half_edge, c.mean[1] + sy, c.mean[2] + sz};
      longest = std::max(longest, whitened_norm(c, corner));
    }
  }
  return longest;
}

// Region where a component can matter: the ellipsoid |W d| <= radius about its mean, and its bounding box.
struct Reach {
  std::uint32_t component;
  double radius;
  double lower[3], upper[3];
};

// Regions where each component's density exceeds `density`; components that never exceed it are omitted.
std::vector<Reach> reaches(const std::vector<Component>& mixture, double density) {
  std::vector<Reach> found;
  for (std::size_t k = 0; k < mixture.size(); ++k) {
    const Component& c = mixture[k];
    const double squared = c.log2_peak - std::log2(density);
    if (squared <= 0.0) continue;
    Reach reach{static_cast<std::uint32_t>(k), std::sqrt(squared), {}, {}};
    // Half-extents of the ellipsoid are radius * (row norms of W^-1).
    const double* w = c.whiten;
    const double i00 = 1.0 / w[0], i11 = 1.0 / w[2], i22 = 1.0 / w[5];
    const double i10 = -w[1] * i00 * i11, i21 = -w[4] * i11 * i22;
    const double i20 = -(w[3] * i00 + w[4] * i10) * i22;
    const double norms[3] = {std::abs(i00), std::hypot(i10, i11), std::sqrt(i20 * i20 + i21 * i21 + i22 * i22)};
    for (int axis = 0; axis < 3; ++axis) {
      reach.lower[axis] = c.mean[axis] - reach.radius * norms[axis];
      reach.upper[axis] = c.mean[axis] + reach.radius * norms[axis];
    }
    found.push_back(reach);
  }
  return found;
}

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

Grid make_grid(const std::vector<Reach>& reached, double voxel_m) {
  const double infinity = std::numeric_limits<double>::infinity();
  double lower[3] = {infinity, infinity, infinity}, upper[3] = {-infinity, -infinity, -infinity};
  for (const Reach& reach : reached) {
    for (int axis = 0; axis < 3; ++axis) {
      lower[axis] = std::min(lower[axis], reach.lower[axis]);
      upper[axis] = std::max(upper[axis], reach.upper[axis]);
    }
  }
  Grid grid{{}, kBrickEdge * voxel_m, {}};
  double names = 1.0;
  for (int axis = 0; axis < 3; ++axis) {
    if (reached.empty()) lower[axis] = upper[axis] = 0.0;  // nothing exceeds the floor
    grid.lower[axis] = lower[axis];
    const double bricks = std::floor((upper[axis] - lower[axis]) / grid.brick_m) + 1.0;
    names *= bricks;
    grid.bricks[axis] = static_cast<std::uint32_t>(std::min(bricks, 5e8));  // its voxels fit in 31 bits
  }
  if (names >= static_cast<double>(kOutsideKey)) {
    throw std::invalid_argument("voxel_m " + std::to_string(voxel_m) + " is too small for a map of this extent");
  }
  return grid;
}

// Components that may matter in each brick: sorted pairs of (brick key, index in `reached`).
std::vector<std::pair<std::uint32_t, std::uint32_t>> near_bricks(const std::vector<Component>& mixture,
                                                                 const std::vector<Reach>& reached,
                                                                 const Grid& grid) {
  std::vector<std::pair<std::uint32_t, std::uint32_t>> near;
  for (std::size_t r = 0; r < reached.size(); ++r) {
    const Reach& reach = reached[r];
    const Component& c = mixture[reach.component];
    const double limit = reach.radius + whitened_reach(c, 0.5 * grid.brick_m);
    std::uint32_t from[3], to[3];
    for (int axis = 0; axis < 3; ++axis) {
      from[axis] = static_cast<std::uint32_t>((reach.lower[axis] - grid.lower[axis]) / grid.brick_m);
      to[axis] = std::min(grid.bricks[axis] - 1,
                          static_cast<std::uint32_t>((reach.upper[axis] - grid.lower[axis]) / grid.brick_m));
    }
    for (std::uint32_t z = from[2]; z <= to[2]; ++z) {
      for (std::uint32_t y = from[1]; y <= to[1]; ++y) {
        for (std::uint32_t x = from[0]; x <= to[0]; ++x) {
          const double middle[3] = {grid.lower[0] + (x + 0.5) * grid.brick_m, grid.lower[1] + (y + 0.5) * grid.brick_m,
                                    grid.lower[2] + (z + 0.5) * grid.brick_m};
          if (whitened_norm(c, middle) <= limit) near.emplace_back(grid.key(x, y, z), static_cast<std::uint32_t>(r));
        }
      }
    }
  }
  std::sort(near.begin(), near.end());
  return near;
}

std::size_t blocks_of(std::size_t components) { return (components + kBlockLanes - 1) / kBlockLanes; }

// Merges the lists of a brick's voxels, so that voxels share lists. Free lanes of a block cost nothing, so they can
// hold components of neighbouring voxels. `place` maps each list to a returned list that contains it and has no more
// blocks.
std::vector<List> merged(const std::vector<List>& lists, std::vector<std::size_t>& place) {
  std::vector<std::size_t> order(lists.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::stable_sort(order.begin(), order.end(),
                   [&lists](std::size_t a, std::size_t b) { return lists[a].size() > lists[b].size(); });
  std::vector<List> shared;
  place.assign(lists.size(), 0);
  List both, best_union;
  for (const std::size_t i : order) {
    const List& list = lists[i];
    if (list.empty()) break;
    const std::size_t blocks = blocks_of(list.size());
    std::size_t best = shared.size(), least_added = list.size();
    for (std::size_t s = 0; s < shared.size(); ++s) {
      if (blocks_of(shared[s].size()) != blocks) continue;
      both.clear();
      std::set_union(shared[s].begin(), shared[s].end(), list.begin(), list.end(), std::back_inserter(both));
      const std::size_t added = both.size() - shared[s].size();
      if (blocks_of(both.size()) != blocks || (added >= least_added && best < shared.size())) continue;
      best = s;
      least_added = added;
      best_union.swap(both);
    }
    place[i] = best;
    if (best == shared.size()) {
      shared.push_back(list);
    } else {
      shared[best] = best_union;
    }
  }
  return shared;
}

struct ListHash {
  std::size_t operator()(const List& list) const {
    std::uint64_t hash = 1469598103934665603ull;  // FNV-1a
    for (const std::uint32_t item : list) hash = (hash ^ item) * 1099511628211ull;
    return static_cast<std::size_t>(hash);
  }
};

// Stores lists as blocks of eight components, with coordinates relative to `centre`. Equal lists are stored once.
class Blocks {
 public:
  Blocks(const std::vector<Component>& mixture, const double* centre, std::vector<float>& blocks)
      : mixture_(mixture), centre_(centre), blocks_(blocks) {}

  // Packed reference to the list, (first block << 8) | blocks.
  std::uint32_t add(const List& list) {
    const auto [entry, is_new] = known_.try_emplace(list, 0);
    if (is_new) {
      const std::size_t first = blocks_.size() / kBlockFloats, blocks = blocks_of(list.size());
      if (blocks > kMaxBlocks || first > kMaxFirstBlock) {
        throw std::invalid_argument("voxel_m does not suit this map: too many components meet in one voxel");
      }
      append(list);
      entry->second = static_cast<std::uint32_t>(first << 8 | blocks);
    }
    return entry->second;
  }

  std::size_t lists() const { return known_.size(); }

 private:
  void append(const List& list) {
    for (std::size_t first = 0; first < list.size(); first += kBlockLanes) {
      const std::size_t at = blocks_.size();
      blocks_.resize(at + kBlockFloats, 0.0f);
      for (std::size_t lane = 0; lane < kBlockLanes; ++lane) {
        float* to = blocks_.data() + at + lane;
        if (first + lane >= list.size()) {
          to[9 * kBlockLanes] = -1000.0f;  // a free lane has no density
          continue;
        }
        const Component& c = mixture_[list[first + lane]];
        const double* w = c.whiten;
        const double m[3] = {c.mean[0] - centre_[0], c.mean[1] - centre_[1], c.mean[2] - centre_[2]};
        const double offset[3] = {-w[0] * m[0], -w[1] * m[0] - w[2] * m[1],
                                  -w[3] * m[0] - w[4] * m[1] - w[5] * m[2]};
        for (int row = 0; row < 6; ++row) to[row * kBlockLanes] = static_cast<float>(w[row]);
        for (int row = 0; row < 3; ++row) to[(6 + row) * kBlockLanes] = static_cast<float>(offset[row]);
        to[9 * kBlockLanes] = static_cast<float>(c.log2_peak);
      }
    }
  }

  const std::vector<Component>& mixture_;
  const double* centre_;
  std::vector<float>& blocks_;
  std::unordered_map<List, std::uint32_t, ListHash> known_;
};

// Open addressing with a load of at most a quarter, so that nearly every lookup ends at its first slot. The lists of
// keys[i] come after those of i other bricks and of the empty brick of free slots.
std::vector<Slot> hash_table(const std::vector<std::uint32_t>& keys, std::uint32_t& shift) {
  std::uint32_t bits = 4;
  while ((std::size_t{1} << bits) < 4 * keys.size()) ++bits;
  shift = 32 - bits;
  std::vector<Slot> slots(std::size_t{1} << bits, Slot{kEmptyKey, 0});
  for (std::size_t i = 0; i < keys.size(); ++i) {
    std::size_t at = (keys[i] * kHashFactor) >> shift;
    while (slots[at].key != kEmptyKey) at = (at + 1) & (slots.size() - 1);
    slots[at] = {keys[i], static_cast<std::uint32_t>((i + 1) * kBrickVoxels)};
  }
  return slots;
}

}  // namespace

MixtureIndex::MixtureIndex(const std::vector<Component>& mixture, const IndexSettings& settings)
    : voxel_m_(settings.voxel_m) {
  const std::vector<Reach> reached =
      reaches(mixture, kCandidateShare * settings.tolerance * settings.floor_density);
  const Grid grid = make_grid(reached, voxel_m_);
  for (int axis = 0; axis < 3; ++axis) {
    bricks_[axis] = static_cast<std::int32_t>(grid.bricks[axis]);
    centre_[axis] = grid.lower[axis] + 0.5 * grid.bricks[axis] * grid.brick_m;
    origin_[axis] = static_cast<float>(grid.lower[axis] - centre_[axis]);
  }
  std::vector<double> limit;  // whitened distance from a voxel's centre within which a component may matter there
  for (const Reach& r : reached) {
    limit.push_back(r.radius + whitened_reach(mixture[r.component], 0.5 * voxel_m_));
  }

  const auto near = near_bricks(mixture, reached, grid);
  Selector selector(mixture, settings);
  Blocks blocks(mixture, centre_, blocks_);
  std::vector<std::uint32_t> keys, names;
  std::vector<List> lists(kBrickVoxels);
  std::vector<std::size_t> place;
  List candidates;
  std::size_t kept = 0;
  voxel_lists_.assign(kBrickVoxels, 0);
  for (std::size_t first = 0, next; first < near.size(); first = next) {
    const std::uint32_t key = near[first].first;
    for (next = first; next < near.size() && near[next].first == key; ++next) {
    }
    double brick[3];
    grid.corner(key, brick);
    std::size_t stored = 0;
    for (std::uint32_t voxel = 0; voxel < kBrickVoxels; ++voxel) {
      const std::uint32_t along[3] = {voxel % kBrickEdge, voxel / kBrickEdge % kBrickEdge,
                                      voxel / (kBrickEdge * kBrickEdge)};
      double corner[3], middle[3];
      for (int axis = 0; axis < 3; ++axis) {
        corner[axis] = brick[axis] + along[axis] * voxel_m_;
        middle[axis] = corner[axis] + 0.5 * voxel_m_;
      }
      candidates.clear();
      for (std::size_t i = first; i < next; ++i) {
        const std::uint32_t r = near[i].second;
        if (whitened_norm(mixture[reached[r].component], middle) <= limit[r]) {
          candidates.push_back(reached[r].component);
        }
      }
      lists[voxel] = selector.select(candidates, corner);
      kept += lists[voxel].size();
      stored += lists[voxel].empty() ? 0 : 1;
    }
    if (stored == 0) continue;
    voxels_ += stored;
    keys.push_back(key);
    if (voxel_lists_.size() > std::numeric_limits<std::uint32_t>::max() - kBrickVoxels) {
      throw std::invalid_argument("voxel_m " + std::to_string(voxel_m_) + " is too small for a map of this extent");
    }
    names.clear();
    for (const List& list : merged(lists, place)) names.push_back(blocks.add(list));
    for (std::uint32_t voxel = 0; voxel < kBrickVoxels; ++voxel) {
      voxel_lists_.push_back(lists[voxel].empty() ? 0 : names[place[voxel]]);
    }
  }
  lists_ = blocks.lists();
  mean_candidates_ = voxels_ == 0 ? 0.0 : static_cast<double>(kept) / static_cast<double>(voxels_);
  slots_ = hash_table(keys, hash_shift_);
}

}  // namespace monoloc
