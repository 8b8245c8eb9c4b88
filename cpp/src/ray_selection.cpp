#include "ray_selection.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "padded.hpp"

namespace monoloc {
namespace {

constexpr float kLeastLog2 = -17.0f;  // log2 of 1e-5; on a ray, components with a smaller share of mass are ignored
constexpr float kTile = 0.2f;         // edge of a tile of rays, at z = 1
constexpr std::size_t kShortlistRows = 13;

// Mean of cameras, as rows of `stride` floats, and the largest distances from it; of rotations, in Frobenius' norm.
struct Cameras {
  double rotation[9] = {}, centre[3] = {};
  double moved = 0.0, turned = 0.0;

  Cameras(const std::vector<float>& rows, std::size_t stride) {
    const auto value = [&](std::size_t row, std::size_t i) { return static_cast<double>(rows[row * stride + i]); };
    for (std::size_t i = 0; i < stride; ++i) {
      for (std::size_t r = 0; r < 9; ++r) rotation[r] += value(r, i) / static_cast<double>(stride);
      for (std::size_t r = 0; r < 3; ++r) centre[r] += value(10 + r, i) / static_cast<double>(stride);
    }
    for (std::size_t i = 0; i < stride; ++i) {
      double by = 0.0, around = 0.0;
      for (std::size_t r = 0; r < 3; ++r) by += std::pow(value(10 + r, i) - centre[r], 2);
      for (std::size_t r = 0; r < 9; ++r) around += std::pow(value(r, i) - rotation[r], 2);
      moved = std::max(moved, std::sqrt(by));
      turned = std::max(turned, std::sqrt(around));
    }
  }
};

// Frobenius norms of a lower triangular matrix (0), (1, 2), (3, 4, 5), and of its inverse.
double norm_of(const float* w) {
  double squares = 0.0;
  for (int i = 0; i < 6; ++i) squares += static_cast<double>(w[i]) * w[i];
  return std::sqrt(squares);
}

double inverse_norm_of(const float* w) {
  const double a = w[0], b = w[2], c = w[5];
  const double entries[6] = {1.0 / a, 1.0 / b, 1.0 / c, w[1] / (a * b), w[4] / (b * c),
                             (static_cast<double>(w[1]) * w[4] - b * w[3]) / (a * b * c)};
  double squares = 0.0;
  for (const double entry : entries) squares += entry * entry;
  return std::sqrt(squares);
}

// Input of the shortlist: the components, as seen by the mean camera, and how far the cameras are from it. Of the
// kShortlistRows rows, six are whiten, three offsets, then log2_peak, norm, least and reach.
class Shortlist {
 public:
  Shortlist(const RayView& view, const Cameras& cameras) : Shortlist(cameras, view.components) {
    for (std::size_t k = 0; k < view.components; ++k) {
      const float* w = view.whiten + 6 * k;
      double offset[3];
      for (int axis = 0; axis < 3; ++axis) offset[axis] = view.means[3 * k + axis] - cameras.centre[axis];
      const double y[3] = {w[0] * offset[0], w[1] * offset[0] + w[2] * offset[1],
                           w[3] * offset[0] + w[4] * offset[1] + w[5] * offset[2]};
      for (std::size_t i = 0; i < 6; ++i) put(i, k, w[i]);
      for (std::size_t i = 0; i < 3; ++i) put(6 + i, k, y[i]);
      put(9, k, view.log2_peak[k]);
      put(10, k, norm_of(w));
      put(11, k, 1.0 / inverse_norm_of(w));
      put(12, k, std::sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2]));
    }
  }

  // `count` of the components of another one.
  Shortlist(const Shortlist& other, const std::uint32_t* components, std::size_t count)
      : Shortlist(other.cameras_, count) {
    for (std::size_t row = 0; row < kShortlistRows; ++row) {
      const float* from = other.rows_.data() + row * other.stride_;
      float* to = rows_.data() + row * stride_;
      for (std::size_t k = 0; k < count; ++k) to[k] = from[components[k]];
    }
  }

  // Components that may matter along any ray within `apart` of (x, y, 1), at any of the cameras; returns their number.
  // listed: capacity of one more than the components, padded.
  std::size_t near(float x, float y, float apart, std::uint32_t* listed) {
    float ray[3];
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const double* row = cameras_.rotation + 3 * axis;
      ray[axis] = static_cast<float>(row[0] * x + row[1] * y + row[2]);
    }
    const float length = std::sqrt(x * x + y * y + 1.0f) + apart;
    const float* at = rows_.data();
    const ShortlistView view{at,
                             at + 6 * stride_,
                             at + 9 * stride_,
                             at + 10 * stride_,
                             at + 11 * stride_,
                             at + 12 * stride_,
                             stride_,
                             static_cast<float>(cameras_.moved),
                             static_cast<float>(cameras_.turned) * length + apart};
    return kernels().ray_shortlist(view, ray, kLeastLog2, bounds_.data(), listed);
  }

 private:
  // Unit Gaussians without mass, which padding keeps.
  Shortlist(const Cameras& cameras, std::size_t components)
      : cameras_(cameras), stride_(padded(components)), rows_(kShortlistRows * stride_), bounds_(stride_) {
    for (const auto& [row, value] : {std::pair{0, 1.0f}, {2, 1.0f}, {5, 1.0f}, {9, -1e9f}, {11, 1.0f}}) {
      std::fill_n(rows_.begin() + static_cast<std::ptrdiff_t>(row * stride_), stride_, value);
    }
  }

  void put(std::size_t row, std::size_t k, double value) { rows_[row * stride_ + k] = static_cast<float>(value); }

  Cameras cameras_;
  std::size_t stride_;
  std::vector<float> rows_, bounds_;
};

// Tile of the ray (x, y, 1); tiles come row by row.
struct Tile {
  float row, column;

  Tile(float x, float y) : row(std::floor(y / kTile)), column(std::floor(x / kTile)) {}
  bool operator==(const Tile& other) const { return row == other.row && column == other.column; }
  bool operator<(const Tile& other) const { return row < other.row || (row == other.row && column < other.column); }
};

// Appends those of `count` listed components that matter along the next ray.
void add_ray(Candidates& candidates, const RayView& view, const std::vector<float>& particles,
             const std::vector<float>& offsets, std::size_t stride, float x, float y, const std::uint32_t* listed,
             std::size_t count, std::vector<float>& scratch) {
  const std::size_t first = candidates.first.back();
  candidates.components.resize(first + count + 1);  // one more than the kernel can return
  scratch.resize(std::max(scratch.size(), count * stride));
  candidates.first.push_back(
      first + kernels().ray_candidates(view, particles.data(), offsets.data(), stride, x, y, kLeastLog2, listed, count,
                                       scratch.data(), candidates.components.data() + first));
}

// Those of the rows that are candidates of any ray; the candidates are renumbered.
Rows chosen_rows(const Rows& rows, Candidates& candidates) {
  const std::size_t all = rows.log2_peak.size();
  candidates.components.resize(candidates.first.back());
  std::vector<std::uint32_t> place(all, 0);
  for (const std::uint32_t k : candidates.components) place[k] = 1;
  Rows chosen;
  for (std::size_t k = 0; k < all; ++k) {
    if (place[k] == 0) continue;
    place[k] = static_cast<std::uint32_t>(chosen.log2_peak.size());
    chosen.whiten.insert(chosen.whiten.end(), rows.whiten.data() + 6 * k, rows.whiten.data() + 6 * k + 6);
    chosen.means.insert(chosen.means.end(), rows.means.data() + 3 * k, rows.means.data() + 3 * k + 3);
    chosen.log2_peak.push_back(rows.log2_peak[k]);
  }
  for (std::uint32_t& k : candidates.components) k = place[k];
  return chosen;
}

// First point of each tile, and the number of points.
std::vector<std::size_t> first_of_tiles(const std::vector<float>& scan, std::size_t points) {
  std::vector<std::size_t> first;
  for (std::size_t p = 0; p < points; ++p) {
    const bool is_same = p > 0 && Tile(scan[p], scan[points + p]) == Tile(scan[p - 1], scan[points + p - 1]);
    if (!is_same) first.push_back(p);
  }
  first.push_back(points);
  return first;
}

// Components that may matter along any ray of each tile.
Candidates tile_candidates(const RayView& view, const Cameras& cameras, const std::vector<float>& scan,
                           std::size_t points, const std::vector<std::size_t>& tiles) {
  Shortlist all(view, cameras);
  std::vector<std::uint32_t> listed(padded(view.components) + 1);
  Candidates candidates{{}, {0}};
  for (std::size_t t = 0; t + 1 < tiles.size(); ++t) {
    const Tile tile(scan[tiles[t]], scan[points + tiles[t]]);
    const float x = (tile.column + 0.5f) * kTile, y = (tile.row + 0.5f) * kTile;  // its middle
    const std::size_t count = all.near(x, y, kTile * std::sqrt(0.5f), listed.data());
    candidates.components.insert(candidates.components.end(), listed.begin(),
                                 listed.begin() + static_cast<std::ptrdiff_t>(count));
    candidates.first.push_back(candidates.components.size());
  }
  return candidates;
}

}  // namespace

std::vector<std::size_t> by_tile(const float* scan, std::size_t points) {
  std::vector<Tile> tiles;
  for (std::size_t p = 0; p < points; ++p) {
    const float* point = scan + 3 * p;
    tiles.emplace_back(point[0] / point[2], point[1] / point[2]);
  }
  std::vector<std::size_t> order(points);
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return tiles[a] < tiles[b]; });
  return order;
}

std::vector<float> offsets_of(const RayView& view, const std::vector<float>& particles, std::size_t stride) {
  std::vector<float> offsets(3 * stride * view.components);
  kernels().ray_offsets(view, particles.data() + 10 * stride, stride, offsets.data());
  return offsets;
}

Candidates candidates_of(const RayView& view, const std::vector<float>& particles, const std::vector<float>& offsets,
                         const std::vector<float>& scan, std::size_t points) {
  Candidates candidates{{}, {0}};
  std::vector<float> scratch;
  std::vector<std::uint32_t> all(view.components);
  std::iota(all.begin(), all.end(), 0u);
  for (std::size_t p = 0; p < points; ++p) {
    add_ray(candidates, view, particles, offsets, kRayBatch, scan[p], scan[points + p], all.data(), all.size(),
            scratch);
  }
  return candidates;
}

Candidates shared_candidates(Rows& rows, const std::vector<float>& particles, std::size_t stride,
                             const std::vector<float>& scan, std::size_t points) {
  const Cameras cameras(particles, stride);
  const std::vector<std::size_t> tiles = first_of_tiles(scan, points);
  Candidates in_tiles = tile_candidates(rows.view(), cameras, scan, points, tiles);
  rows = chosen_rows(rows, in_tiles);

  const RayView view = rows.view();
  const Shortlist all(view, cameras);
  const std::vector<float> offsets = offsets_of(view, particles, stride);
  std::vector<float> scratch;
  std::vector<std::uint32_t> listed(padded(view.components) + 1);
  Candidates candidates{{}, {0}};
  for (std::size_t t = 0; t + 1 < tiles.size(); ++t) {
    const std::uint32_t* in_tile = in_tiles.components.data() + in_tiles.first[t];
    Shortlist some(all, in_tile, in_tiles.first[t + 1] - in_tiles.first[t]);
    for (std::size_t p = tiles[t]; p < tiles[t + 1]; ++p) {
      const float x = scan[p], y = scan[points + p];
      const std::size_t count = some.near(x, y, 0.0f, listed.data());
      for (std::size_t i = 0; i < count; ++i) listed[i] = in_tile[listed[i]];
      add_ray(candidates, view, particles, offsets, stride, x, y, listed.data(), count, scratch);
    }
  }
  rows = chosen_rows(rows, candidates);
  return candidates;
}

}  // namespace monoloc
