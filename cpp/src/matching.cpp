#include "monoloc/matching.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>
#include <utility>

#include "monoloc/kernels.hpp"

namespace monoloc {
namespace {

static_assert(kDescriptorBytes == kDescriptorWords * sizeof(std::uint64_t), "whole words");

constexpr std::size_t kBlock = 512;  // known descriptors at a time, which stay in the cache for all others
constexpr std::int32_t kMoreThanAll = 8 * kDescriptorBytes + 1;

void append_descriptor(const Corners& corners, std::size_t index, std::vector<std::uint64_t>& words) {
  words.resize(words.size() + kDescriptorWords);
  std::memcpy(words.data() + words.size() - kDescriptorWords, corners.descriptors + kDescriptorBytes * index,
              kDescriptorBytes);
}

std::vector<std::uint64_t> words_of(const Descriptors& descriptors) {
  std::vector<std::uint64_t> words(kDescriptorWords * descriptors.count);
  if (!words.empty()) std::memcpy(words.data(), descriptors.bytes, kDescriptorBytes * descriptors.count);
  return words;
}

// Keypoints by the cells of a grid that have about one each: row by row, and in a row from left to right.
class Grid {
 public:
  explicit Grid(const Corners& keypoints) : pixels_(keypoints.pixels) {
    double right = -kInfinity, bottom = -kInfinity;
    for (std::size_t i = 0; i < keypoints.count; ++i) {
      if (!std::isfinite(x(i)) || !std::isfinite(y(i))) continue;
      index.push_back(i);
      left_ = std::min(left_, x(i));
      right = std::max(right, x(i));
      top_ = std::min(top_, y(i));
      bottom = std::max(bottom, y(i));
    }
    if (index.empty()) return;
    side_ = std::ceil(std::sqrt(static_cast<double>(index.size())));
    cells_per_px_ = side_ / std::max(std::max(right - left_, bottom - top_), 1.0);
    std::stable_sort(index.begin(), index.end(), [this](std::size_t a, std::size_t b) { return cell(a) < cell(b); });
    starts_.assign(cells() * cells() + 1, 0);
    for (const std::size_t i : index) ++starts_[cell(i) + 1];
    std::partial_sum(starts_.begin(), starts_.end(), starts_.begin());
    for (const std::size_t i : index) append_descriptor(keypoints, i, descriptors);
  }

  // Calls with the first place and the number of keypoints of each row that may be within a radius of a pixel.
  template <class Visit>
  void rows_near(double at_x, double at_y, double radius_px, Visit visit) const {
    if (index.empty()) return;
    const double reach_px = radius_px + kRoundingPx;  // is_near rounds differences
    const std::size_t first = along(at_x - reach_px, left_), last = along(at_x + reach_px, left_);
    for (std::size_t row = along(at_y - reach_px, top_); row <= along(at_y + reach_px, top_); ++row) {
      const std::size_t begin = starts_[row * cells() + first], end = starts_[row * cells() + last + 1];
      if (begin < end) visit(begin, end - begin);
    }
  }

  // Whether the keypoint at a place is within a radius of a pixel: on the left also at the radius.
  bool is_near(std::size_t place, double at_x, double at_y, double radius_px) const {
    const double its_x = x(index[place]), its_y = y(index[place]);
    return its_x >= at_x - radius_px && its_x < at_x + radius_px && std::abs(at_y - its_y) < radius_px;
  }

  // Whether of two keypoints as near to a landmark the one at place a counts.
  bool precedes(std::size_t a, std::size_t b) const {
    return std::make_pair(x(index[a]), index[a]) < std::make_pair(x(index[b]), index[b]);
  }

  std::vector<std::size_t> index;  // of the keypoint at each place
  std::vector<std::uint64_t> descriptors;

 private:
  static constexpr double kInfinity = std::numeric_limits<double>::infinity(), kRoundingPx = 1e-6;

  double x(std::size_t keypoint) const { return pixels_[2 * keypoint]; }
  double y(std::size_t keypoint) const { return pixels_[2 * keypoint + 1]; }
  std::size_t cells() const { return static_cast<std::size_t>(side_); }

  // The cell along one axis; the outermost ones have no outer edge.
  std::size_t along(double pixel, double first) const {
    return static_cast<std::size_t>(std::min(std::max(0.0, (pixel - first) * cells_per_px_), side_ - 1.0));
  }

  std::size_t cell(std::size_t keypoint) const {
    return along(y(keypoint), top_) * cells() + along(x(keypoint), left_);
  }

  const double* pixels_;
  double left_ = kInfinity, top_ = kInfinity, side_ = 0.0, cells_per_px_ = 0.0;
  std::vector<std::size_t> starts_;  // of the cells, and the end of the last one
};

// The best match of a corner so far.
struct Best {
  std::uint32_t bits;
  std::size_t other;
};

}  // namespace

Matches match_descriptors(const Corners& landmarks, const Corners& keypoints, double radius_px, int most_bits) {
  const Grid grid(keypoints);
  const std::size_t none = grid.index.size();
  const auto most = static_cast<std::uint32_t>(std::max(most_bits, 0));
  std::vector<Best> of_landmark(landmarks.count, {most, none});
  std::vector<Best> of_keypoint(none, {most, landmarks.count});
  std::vector<std::uint32_t> places(none), bits(none);
  std::vector<std::uint64_t> known;
  for (std::size_t i = 0; i < landmarks.count; ++i) {
    const double x = landmarks.pixels[2 * i], y = landmarks.pixels[2 * i + 1];
    if (std::isnan(x) || std::isnan(y)) continue;
    known.clear();
    append_descriptor(landmarks, i, known);
    Best& best = of_landmark[i];
    grid.rows_near(x, y, radius_px, [&](std::size_t first, std::size_t count) {
      const std::size_t found = kernels().similar_descriptors(
          known.data(), grid.descriptors.data() + kDescriptorWords * first, count, most, places.data(), bits.data());
      for (std::size_t n = 0; n < found; ++n) {
        const std::size_t place = first + places[n];
        if (!grid.is_near(place, x, y, radius_px)) continue;
        if (bits[n] < best.bits || (bits[n] == best.bits && grid.precedes(place, best.other))) best = {bits[n], place};
        if (bits[n] < of_keypoint[place].bits) of_keypoint[place] = {bits[n], i};
      }
    });
  }
  Matches matches;
  for (std::size_t i = 0; i < landmarks.count; ++i) {
    const std::size_t place = of_landmark[i].other;
    if (place == none || of_keypoint[place].other != i) continue;
    matches.landmarks.push_back(static_cast<std::int64_t>(i));
    matches.keypoints.push_back(static_cast<std::int64_t>(grid.index[place]));
  }
  return matches;
}

Nearest nearest_descriptors(const Descriptors& descriptors, const Descriptors& known, std::size_t kept,
                            int most_bits) {
  const std::vector<std::uint64_t> ours = words_of(descriptors), theirs = words_of(known);
  Nearest nearest{std::vector<std::int32_t>(descriptors.count * kept, kMoreThanAll),
                  std::vector<std::int64_t>(descriptors.count * kept)};
  if (kept == 0) return nearest;
  std::vector<std::uint32_t> bits(kBlock), places(kBlock);
  for (std::size_t first = 0; first < known.count; first += kBlock) {
    const std::size_t count = std::min(kBlock, known.count - first);
    for (std::size_t d = 0; d < descriptors.count; ++d) {
      std::int32_t* best = nearest.bits.data() + kept * d;
      std::int64_t* at = nearest.known.data() + kept * d;
      const auto limit = static_cast<std::uint32_t>(std::clamp(most_bits, 0, best[kept - 1]));
      const std::size_t found = kernels().similar_descriptors(ours.data() + kDescriptorWords * d,
                                                              theirs.data() + kDescriptorWords * first, count, limit,
                                                              places.data(), bits.data());
      for (std::size_t i = 0; i < found; ++i) {
        const auto differing = static_cast<std::int32_t>(bits[i]);
        if (differing >= best[kept - 1]) continue;
        std::size_t place = kept - 1;
        for (; place > 0 && best[place - 1] > differing; --place) {
          best[place] = best[place - 1];
          at[place] = at[place - 1];
        }
        best[place] = differing;
        at[place] = static_cast<std::int64_t>(first + places[i]);
      }
    }
  }
  return nearest;
}

}  // namespace monoloc
