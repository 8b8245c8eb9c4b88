#include "bricks.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <stdexcept>
#include <string>

namespace monoloc {
namespace {

constexpr double kCandidateShare = 0.1;  // of the allowed error; components below it are not sampled

Vec3 whitened(const Component& c, const double* point) {
  const double* w = c.whiten;
  const double d[3] = {point[0] - c.mean[0], point[1] - c.mean[1], point[2] - c.mean[2]};
  return {w[0] * d[0], w[1] * d[0] + w[2] * d[1], w[3] * d[0] + w[4] * d[1] + w[5] * d[2]};
}

// By how much each whitened coordinate differs, at most, between the centre of a cube and its other points.
Vec3 whitened_spans(const Component& c, double half_edge) {
  const double* w = c.whiten;
  return {half_edge * std::abs(w[0]), half_edge * (std::abs(w[1]) + std::abs(w[2])),
          half_edge * (std::abs(w[3]) + std::abs(w[4]) + std::abs(w[5]))};
}

// Whether a cube about a point may come within a whitened radius of a component: never false where it does.
bool comes_within(const Component& c, const double* middle, const Vec3& spans, double radius) {
  const Vec3 y = whitened(c, middle);
  double squared = 0.0;
  for (std::size_t i = 0; i < 3; ++i) {
    const double least = std::max(0.0, std::abs(y[i]) - spans[i]);
    squared += least * least;
  }
  return squared <= radius * radius;
}

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
    const Vec3 spans = whitened_spans(c, 0.5 * grid.brick_m);
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
          if (comes_within(c, middle, spans, reach.radius)) {
            near.emplace_back(grid.key(x, y, z), static_cast<std::uint32_t>(r));
          }
        }
      }
    }
  }
  std::sort(near.begin(), near.end());
  return near;
}

// Merges the lists of a brick's voxels, so that voxels share lists. Free lanes of a block cost nothing, so they can
// hold components of neighbouring voxels. `place` maps each list to a returned list that contains it and has no more
// blocks, and an empty one to kNoList.
std::vector<List> merged(const std::vector<List>& lists, std::vector<std::size_t>& place) {
  std::vector<std::size_t> order(lists.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::stable_sort(order.begin(), order.end(),
                   [&lists](std::size_t a, std::size_t b) { return lists[a].size() > lists[b].size(); });
  std::vector<List> shared;
  place.assign(lists.size(), kNoList);
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

}  // namespace

Bricks::Bricks(const std::vector<Component>& mixture, const IndexSettings& settings)
    : mixture_(mixture),
      voxel_m_(settings.voxel_m),
      reached_(reaches(mixture, kCandidateShare * settings.tolerance * settings.floor_density)),
      grid_(make_grid(reached_, voxel_m_)),
      near_(near_bricks(mixture, reached_, grid_)) {
  for (const Reach& r : reached_) spans_.push_back(whitened_spans(mixture[r.component], 0.5 * voxel_m_));
  for (std::size_t i = 0; i < near_.size(); ++i) {
    if (i == 0 || near_[i].first != near_[i - 1].first) firsts_.push_back(i);
  }
  firsts_.push_back(near_.size());
}

void Bricks::find_candidates(std::size_t i, std::vector<List>& found) const {
  for (List& list : found) list.clear();
  double corner[3];
  grid_.corner(near_[firsts_[i]].first, corner);
  for (std::size_t n = firsts_[i]; n < firsts_[i + 1]; ++n) {
    const std::uint32_t r = near_[n].second;
    const Reach& reach = reached_[r];
    std::uint32_t from[3], to[3];  // the voxels that its box meets
    for (int axis = 0; axis < 3; ++axis) {
      const double most = kBrickEdge - 1.0;
      const double low = std::floor((reach.lower[axis] - corner[axis]) / voxel_m_);
      const double high = std::floor((reach.upper[axis] - corner[axis]) / voxel_m_);
      from[axis] = static_cast<std::uint32_t>(std::clamp(low, 0.0, most));
      to[axis] = static_cast<std::uint32_t>(std::clamp(high, 0.0, most));
    }
    for (std::uint32_t z = from[2]; z <= to[2]; ++z) {
      for (std::uint32_t y = from[1]; y <= to[1]; ++y) {
        for (std::uint32_t x = from[0]; x <= to[0]; ++x) {
          const double middle[3] = {corner[0] + (x + 0.5) * voxel_m_, corner[1] + (y + 0.5) * voxel_m_,
                                    corner[2] + (z + 0.5) * voxel_m_};
          if (comes_within(mixture_[reach.component], middle, spans_[r], reach.radius)) {
            found[(z * kBrickEdge + y) * kBrickEdge + x].push_back(reach.component);
          }
        }
      }
    }
  }
}

BrickLists Bricks::lists(std::size_t i, BrickBuffers& buffers) const {
  BrickLists brick;
  brick.key = near_[firsts_[i]].first;
  double lower[3];
  grid_.corner(brick.key, lower);
  std::vector<List>& lists = buffers.voxels;
  find_candidates(i, lists);
  for (std::uint32_t voxel = 0; voxel < kBrickVoxels; ++voxel) {
    const std::uint32_t along[3] = {voxel % kBrickEdge, voxel / kBrickEdge % kBrickEdge,
                                    voxel / (kBrickEdge * kBrickEdge)};
    double corner[3];
    for (int axis = 0; axis < 3; ++axis) corner[axis] = lower[axis] + along[axis] * voxel_m_;
    buffers.selector.select(lists[voxel], corner);
    brick.components += lists[voxel].size();
    brick.voxels += lists[voxel].empty() ? 0 : 1;
  }
  brick.lists = merged(lists, brick.list_of_voxel);
  return brick;
}

}  // namespace monoloc
