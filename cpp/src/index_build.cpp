// Construction of the index: the lists of all bricks, stored as blocks of components.
#include <algorithm>
#include <limits>
#include <stdexcept>
#include <string>
#include <unordered_map>

#include "bricks.hpp"
#include "monoloc/index.hpp"
#include "pool.hpp"

namespace monoloc {
namespace {

constexpr std::size_t kMaxBlocks = 255, kMaxFirstBlock = (1u << 24) - 1;  // limits of a packed list
constexpr std::size_t kBatch = 2048, kShare = 32;  // bricks whose lists are in memory at once, and those of a task

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

// Lists of a batch of bricks from the first on, on several threads.
std::vector<BrickLists> batch_of(const Bricks& bricks, std::size_t first, const Selector& selector,
                                 std::size_t threads) {
  std::vector<BrickLists> batch(std::min(kBatch, bricks.size() - first));
  run_on_threads((batch.size() + kShare - 1) / kShare, threads, [&](std::size_t share) {
    BrickBuffers own{selector};
    for (std::size_t i = share * kShare; i < std::min(batch.size(), (share + 1) * kShare); ++i) {
      batch[i] = bricks.lists(first + i, own);
    }
  });
  return batch;
}

}  // namespace

MixtureIndex::MixtureIndex(const std::vector<Component>& mixture, const IndexSettings& settings)
    : voxel_m_(settings.voxel_m) {
  const Bricks bricks(mixture, settings);
  const Grid& grid = bricks.grid();
  for (int axis = 0; axis < 3; ++axis) {
    bricks_[axis] = static_cast<std::int32_t>(grid.bricks[axis]);
    centre_[axis] = grid.lower[axis] + 0.5 * grid.bricks[axis] * grid.brick_m;
    origin_[axis] = static_cast<float>(grid.lower[axis] - centre_[axis]);
  }
  const Selector selector(mixture, settings);
  Blocks blocks(mixture, centre_, blocks_);
  std::vector<std::uint32_t> keys, names;
  std::size_t kept = 0;
  voxel_lists_.assign(kBrickVoxels, 0);
  for (std::size_t first = 0; first < bricks.size(); first += kBatch) {
    settings.pause();
    for (const BrickLists& brick : batch_of(bricks, first, selector, settings.threads)) {
      if (brick.voxels == 0) continue;
      voxels_ += brick.voxels;
      kept += brick.components;
      keys.push_back(brick.key);
      if (voxel_lists_.size() > std::numeric_limits<std::uint32_t>::max() - kBrickVoxels) {
        throw std::invalid_argument("voxel_m " + std::to_string(voxel_m_) + " is too small for a map of this extent");
      }
      names.clear();
      for (const List& list : brick.lists) names.push_back(blocks.add(list));
      for (const std::size_t list : brick.list_of_voxel) voxel_lists_.push_back(list == kNoList ? 0 : names[list]);
    }
  }
  lists_ = blocks.lists();
  mean_candidates_ = voxels_ == 0 ? 0.0 : static_cast<double>(kept) / static_cast<double>(voxels_);
  slots_ = hash_table(keys, hash_shift_);
}

}  // namespace monoloc
