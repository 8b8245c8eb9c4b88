// How the index is built: which voxels are near the map, and which components matter in each.
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <unordered_map>

#include "monoloc/index.hpp"
#include "padded.hpp"

namespace monoloc {
namespace {

// A voxel is probed on a lattice that includes its faces, of a spacing that no component slips through.
constexpr double kSamplesPerSigma = 0.4;  // of the thinnest component
constexpr std::size_t kFewestPerAxis = 5, kMostPerAxis = 17;
constexpr double kHalfLog2E = 0.72134752044448170;  // squared scale of Component::whiten
constexpr double kCandidateShare = 0.1;  // of the error allowed: a component below it is not even probed
constexpr std::size_t kMaxBlocks = 255, kMaxFirstBlock = (1u << 24) - 1;  // what a Slot can name

struct Candidate {
  std::uint32_t voxel;
  std::uint32_t component;
};

// Lower and upper corner of the box in which a component's density exceeds `density`; false if nowhere.
bool reach(const Component& c, double density, double lower[3], double upper[3], double& radius) {
  const double squared = c.log2_peak - std::log2(density);
  if (squared <= 0.0) return false;
  radius = std::sqrt(squared);
  // Half-extents of the ellipsoid |W d| <= radius are radius * (row norms of W^-1).
  const double* w = c.whiten;
  const double i00 = 1.0 / w[0], i11 = 1.0 / w[2], i22 = 1.0 / w[5];
  const double i10 = -w[1] * i00 * i11, i21 = -w[4] * i11 * i22;
  const double i20 = -(w[3] * i00 + w[4] * i10) * i22;
  const double norms[3] = {std::abs(i00), std::hypot(i10, i11), std::sqrt(i20 * i20 + i21 * i21 + i22 * i22)};
  for (int axis = 0; axis < 3; ++axis) {
    lower[axis] = c.mean[axis] - radius * norms[axis];
    upper[axis] = c.mean[axis] + radius * norms[axis];
  }
  return true;
}

double whitened_norm(const Component& c, double x, double y, double z) {
  const double* w = c.whiten;
  const double y0 = w[0] * x;
  const double y1 = w[1] * x + w[2] * y;
  const double y2 = w[3] * x + w[4] * y + w[5] * z;
  return std::sqrt(y0 * y0 + y1 * y1 + y2 * y2);
}

// Largest whitened length from a voxel's centre to its surface: at one of the corners.
double whitened_reach(const Component& c, double half) {
  double longest = 0.0;
  for (const double sy : {-half, half}) {
    for (const double sz : {-half, half}) longest = std::max(longest, whitened_norm(c, half, sy, sz));
  }
  return longest;
}

std::size_t samples_per_axis(const std::vector<Component>& mixture, double voxel_m) {
  double steepest = 0.0;  // Frobenius norm of L^-1: at least 1 / (smallest standard deviation), at most sqrt(3) of it
  for (const Component& c : mixture) {
    double squared = 0.0;
    for (const double w : c.whiten) squared += w * w;
    steepest = std::max(steepest, std::sqrt(squared / kHalfLog2E));
  }
  const double wanted = std::min(std::ceil(voxel_m * steepest * kSamplesPerSigma) + 1.0, 1e6);
  return std::clamp(static_cast<std::size_t>(wanted), kFewestPerAxis, kMostPerAxis);
}

// Chooses the components of one voxel. Dropping a set D costs at a sample s the relative density
// sum_D p_k(s) / (sum_all p_k(s) + floor); components are dropped, least important first, while that stays
// within the tolerance at every sample.
class Selector {
 public:
  Selector(const std::vector<Component>& mixture, const IndexSettings& settings)
      : mixture_(mixture), settings_(settings) {
    const std::size_t per_axis = samples_per_axis(mixture, settings.voxel_m);
    const std::size_t samples = per_axis * per_axis * per_axis;
    stride_ = padded(samples);
    offsets_.resize(3 * stride_);
    const double step = settings.voxel_m / static_cast<double>(per_axis - 1);
    for (std::size_t i = 0; i < stride_; ++i) {
      const std::size_t s = std::min(i, samples - 1);
      const std::size_t along[3] = {s % per_axis, s / per_axis % per_axis, s / (per_axis * per_axis)};
      for (int axis = 0; axis < 3; ++axis) {
        offsets_[axis * stride_ + i] = static_cast<float>(step * static_cast<double>(along[axis]));
      }
    }
  }

  // Components kept, ascending; corner: the voxel's lower corner in the mixture's frame.
  std::vector<std::uint32_t> select(const Candidate* candidates, std::size_t count, const double* corner) {
    densities_.resize(count * stride_);
    total_.assign(stride_, static_cast<float>(settings_.floor_density));
    for (std::size_t c = 0; c < count; ++c) {
      float* density = densities_.data() + c * stride_;
      kernels().component_density(mixture_[candidates[c].component], corner, offsets_.data(), stride_, density);
      for (std::size_t s = 0; s < stride_; ++s) total_[s] += density[s];
    }
    importance_.clear();
    for (std::size_t c = 0; c < count; ++c) {
      float* share = densities_.data() + c * stride_;
      float most = 0.0f;
      for (std::size_t s = 0; s < stride_; ++s) {
        share[s] /= total_[s];
        most = std::max(most, share[s]);
      }
      importance_.push_back({most, c});
    }
    std::sort(importance_.begin(), importance_.end());
    dropped_.assign(stride_, 0.0f);
    std::vector<std::uint32_t> kept;
    for (const auto& [most, c] : importance_) {
      if (kept.empty() && drop(densities_.data() + c * stride_)) continue;
      kept.push_back(candidates[c].component);
    }
    std::sort(kept.begin(), kept.end());
    return kept;
  }

 private:
  bool drop(const float* share) {
    float most = 0.0f;
    for (std::size_t s = 0; s < stride_; ++s) most = std::max(most, dropped_[s] + share[s]);
    if (most > static_cast<float>(settings_.tolerance)) return false;
    for (std::size_t s = 0; s < stride_; ++s) dropped_[s] += share[s];
    return true;
  }

  const std::vector<Component>& mixture_;
  const IndexSettings& settings_;
  std::size_t stride_;
  std::vector<float> offsets_, densities_, total_, dropped_;
  std::vector<std::pair<float, std::size_t>> importance_;
};

// Appends blocks of eight components; free lanes have no density. Coordinates are relative to `centre`.
void append_blocks(const std::vector<Component>& mixture, const std::vector<std::uint32_t>& list,
                   const double* centre, std::vector<float>& blocks) {
  for (std::size_t first = 0; first < list.size(); first += kBlockLanes) {
    const std::size_t at = blocks.size();
    blocks.resize(at + kBlockFloats, 0.0f);
    float* block = blocks.data() + at;
    for (std::size_t lane = 0; lane < kBlockLanes; ++lane) {
      float* to = block + lane;
      if (first + lane >= list.size()) {
        to[9 * kBlockLanes] = -1000.0f;
        continue;
      }
      const Component& c = mixture[list[first + lane]];
      const double* w = c.whiten;
      const double m[3] = {c.mean[0] - centre[0], c.mean[1] - centre[1], c.mean[2] - centre[2]};
      const double values[10] = {w[0],         w[1],
                                 w[2],         w[3],
                                 w[4],         w[5],
                                 -w[0] * m[0], -w[1] * m[0] - w[2] * m[1],
                                 -w[3] * m[0] - w[4] * m[1] - w[5] * m[2], c.log2_peak};
      for (int row = 0; row < 10; ++row) to[row * kBlockLanes] = static_cast<float>(values[row]);
    }
  }
}

struct ListHash {
  std::size_t operator()(const std::vector<std::uint32_t>& list) const {
    std::uint64_t hash = 1469598103934665603ull;  // FNV-1a
    for (const std::uint32_t item : list) hash = (hash ^ item) * 1099511628211ull;
    return static_cast<std::size_t>(hash);
  }
};

}  // namespace

MixtureIndex::MixtureIndex(const std::vector<Component>& mixture, const IndexSettings& settings)
    : voxel_m_(settings.voxel_m) {
  const double candidate_density = kCandidateShare * settings.tolerance * settings.floor_density;
  const double infinity = std::numeric_limits<double>::infinity();
  double lower[3] = {infinity, infinity, infinity}, upper[3] = {-infinity, -infinity, -infinity};
  for (const Component& c : mixture) {
    double lo[3], hi[3], radius;
    if (!reach(c, candidate_density, lo, hi, radius)) continue;
    for (int axis = 0; axis < 3; ++axis) {
      lower[axis] = std::min(lower[axis], lo[axis]);
      upper[axis] = std::max(upper[axis], hi[axis]);
    }
  }
  double names = 1.0;
  for (int axis = 0; axis < 3; ++axis) {
    if (!(lower[axis] <= upper[axis])) lower[axis] = upper[axis] = 0.0;  // nothing exceeds the floor
    centre_[axis] = 0.5 * (lower[axis] + upper[axis]);
    origin_[axis] = static_cast<float>(lower[axis] - centre_[axis]);
    const double cells = std::floor((upper[axis] - lower[axis]) / voxel_m_) + 1.0;
    names *= cells;
    shape_[axis] = static_cast<std::int32_t>(std::min(cells, 2e9));
  }
  if (names >= static_cast<double>(kOutsideKey)) {
    throw std::invalid_argument("voxel_m " + std::to_string(voxel_m_) + " is too small for a map of this extent");
  }

  const double half = 0.5 * voxel_m_;
  std::vector<Candidate> candidates;
  for (std::size_t k = 0; k < mixture.size(); ++k) {
    const Component& c = mixture[k];
    double lo[3], hi[3], radius;
    if (!reach(c, candidate_density, lo, hi, radius)) continue;
    const double limit = radius + whitened_reach(c, half);
    std::int32_t from[3], to[3];
    for (int axis = 0; axis < 3; ++axis) {
      from[axis] = static_cast<std::int32_t>((lo[axis] - lower[axis]) / voxel_m_);
      to[axis] = std::min(shape_[axis] - 1, static_cast<std::int32_t>((hi[axis] - lower[axis]) / voxel_m_));
    }
    for (std::int32_t iz = from[2]; iz <= to[2]; ++iz) {
      for (std::int32_t iy = from[1]; iy <= to[1]; ++iy) {
        for (std::int32_t ix = from[0]; ix <= to[0]; ++ix) {
          const double dx = lower[0] + (ix + 0.5) * voxel_m_ - c.mean[0];
          const double dy = lower[1] + (iy + 0.5) * voxel_m_ - c.mean[1];
          const double dz = lower[2] + (iz + 0.5) * voxel_m_ - c.mean[2];
          if (whitened_norm(c, dx, dy, dz) > limit) continue;
          const auto row = static_cast<std::uint32_t>(iz) * static_cast<std::uint32_t>(shape_[1]) +
                           static_cast<std::uint32_t>(iy);
          candidates.push_back({row * static_cast<std::uint32_t>(shape_[0]) + static_cast<std::uint32_t>(ix),
                                static_cast<std::uint32_t>(k)});
        }
      }
    }
  }
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return a.voxel < b.voxel; });

  // Voxels with the same components share one list.
  std::vector<Slot> found;
  std::unordered_map<std::vector<std::uint32_t>, std::uint32_t, ListHash> known;
  Selector selector(mixture, settings);
  std::size_t kept_sum = 0;
  for (std::size_t first = 0, next; first < candidates.size(); first = next) {
    const std::uint32_t voxel = candidates[first].voxel;
    for (next = first; next < candidates.size() && candidates[next].voxel == voxel; ++next) {
    }
    const auto nx = static_cast<std::uint32_t>(shape_[0]), ny = static_cast<std::uint32_t>(shape_[1]);
    const double corner[3] = {lower[0] + voxel % nx * voxel_m_, lower[1] + voxel / nx % ny * voxel_m_,
                              lower[2] + voxel / (nx * ny) * voxel_m_};
    std::vector<std::uint32_t> kept = selector.select(candidates.data() + first, next - first, corner);
    if (kept.empty()) continue;
    kept_sum += kept.size();
    auto entry = known.find(kept);
    if (entry == known.end()) {
      const std::size_t first_block = blocks_.size() / kBlockFloats;
      append_blocks(mixture, kept, centre_, blocks_);
      const std::size_t blocks = blocks_.size() / kBlockFloats - first_block;
      if (blocks > kMaxBlocks || first_block > kMaxFirstBlock) {
        throw std::invalid_argument("voxel_m " + std::to_string(voxel_m_) +
                                    " does not suit this map: too many components meet in one voxel");
      }
      entry = known.emplace(std::move(kept), static_cast<std::uint32_t>(first_block << 8 | blocks)).first;
    }
    found.push_back({voxel, entry->second});
  }
  voxels_ = found.size();
  lists_ = known.size();
  mean_candidates_ = voxels_ == 0 ? 0.0 : static_cast<double>(kept_sum) / static_cast<double>(voxels_);

  // Open addressing, at most a quarter full: nearly every look-up ends at its first slot.
  std::uint32_t bits = 4;
  while ((std::size_t{1} << bits) < 4 * found.size()) ++bits;
  hash_shift_ = 32 - bits;
  slots_.assign(std::size_t{1} << bits, Slot{kEmptyKey, 0});
  for (const Slot& slot : found) {
    std::size_t at = (slot.key * kHashFactor) >> hash_shift_;
    while (slots_[at].key != kEmptyKey) at = (at + 1) & (slots_.size() - 1);
    slots_[at] = slot;
  }
}

}  // namespace monoloc
