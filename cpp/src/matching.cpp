#include "monoloc/matching.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>

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

// Keypoints by increasing x.
struct Sorted {
  std::vector<std::size_t> index;
  std::vector<double> x, y;
  std::vector<std::uint64_t> descriptors;
};

Sorted sorted_by_x(const Corners& keypoints) {
  Sorted sorted;
  sorted.index.reserve(keypoints.count);
  for (std::size_t i = 0; i < keypoints.count; ++i) {
    if (!std::isnan(keypoints.pixels[2 * i])) sorted.index.push_back(i);
  }
  std::stable_sort(sorted.index.begin(), sorted.index.end(), [&keypoints](std::size_t a, std::size_t b) {
    return keypoints.pixels[2 * a] < keypoints.pixels[2 * b];
  });
  for (const std::size_t i : sorted.index) {
    sorted.x.push_back(keypoints.pixels[2 * i]);
    sorted.y.push_back(keypoints.pixels[2 * i + 1]);
    append_descriptor(keypoints, i, sorted.descriptors);
  }
  return sorted;
}

// The best match of a corner so far.
struct Best {
  std::uint32_t bits;
  std::size_t other;
};

}  // namespace

Matches match_descriptors(const Corners& landmarks, const Corners& keypoints, double radius_px, int most_bits) {
  const Sorted sorted = sorted_by_x(keypoints);
  const std::size_t none = sorted.index.size();
  const auto most = static_cast<std::uint32_t>(std::max(most_bits, 0));
  std::vector<Best> of_landmark(landmarks.count, {most, none});
  std::vector<Best> of_keypoint(sorted.index.size(), {most, landmarks.count});
  std::vector<std::uint32_t> near(sorted.index.size()), bits(sorted.index.size());
  std::vector<std::uint64_t> known;
  for (std::size_t i = 0; i < landmarks.count; ++i) {
    const double x = landmarks.pixels[2 * i], y = landmarks.pixels[2 * i + 1];
    if (std::isnan(x)) continue;
    const auto first = std::lower_bound(sorted.x.begin(), sorted.x.end(), x - radius_px);
    const auto last = std::lower_bound(first, sorted.x.end(), x + radius_px);
    std::size_t count = 0;
    for (auto place = static_cast<std::size_t>(first - sorted.x.begin());
         place < static_cast<std::size_t>(last - sorted.x.begin()); ++place) {
      near[count] = static_cast<std::uint32_t>(place);
      count += std::abs(y - sorted.y[place]) < radius_px;
    }
    known.clear();
    append_descriptor(landmarks, i, known);
    kernels().differing_bits(known.data(), sorted.descriptors.data(), near.data(), count, bits.data());
    for (std::size_t n = 0; n < count; ++n) {
      const std::size_t place = near[n];
      if (bits[n] < of_landmark[i].bits) of_landmark[i] = {bits[n], place};
      if (bits[n] < of_keypoint[place].bits) of_keypoint[place] = {bits[n], i};
    }
  }
  Matches matches;
  for (std::size_t i = 0; i < landmarks.count; ++i) {
    const std::size_t place = of_landmark[i].other;
    if (place == none || of_keypoint[place].other != i) continue;
    matches.landmarks.push_back(static_cast<std::int64_t>(i));
    matches.keypoints.push_back(static_cast<std::int64_t>(sorted.index[place]));
  }
  return matches;
}

Nearest nearest_descriptors(const Descriptors& descriptors, const Descriptors& known, std::size_t kept) {
  const std::vector<std::uint64_t> ours = words_of(descriptors), theirs = words_of(known);
  Nearest nearest{std::vector<std::int32_t>(descriptors.count * kept, kMoreThanAll),
                  std::vector<std::int64_t>(descriptors.count * kept)};
  if (kept == 0) return nearest;
  std::vector<std::uint32_t> bits(kBlock), block(kBlock);
  std::iota(block.begin(), block.end(), 0u);
  for (std::size_t first = 0; first < known.count; first += kBlock) {
    const std::size_t count = std::min(kBlock, known.count - first);
    for (std::size_t d = 0; d < descriptors.count; ++d) {
      kernels().differing_bits(ours.data() + kDescriptorWords * d, theirs.data() + kDescriptorWords * first,
                               block.data(), count, bits.data());
      std::int32_t* best = nearest.bits.data() + kept * d;
      std::int64_t* at = nearest.known.data() + kept * d;
      for (std::size_t i = 0; i < count; ++i) {
        const auto differing = static_cast<std::int32_t>(bits[i]);
        if (differing >= best[kept - 1]) continue;
        std::size_t place = kept - 1;
        for (; place > 0 && best[place - 1] > differing; --place) {
          best[place] = best[place - 1];
          at[place] = at[place - 1];
        }
        best[place] = differing;
        at[place] = static_cast<std::int64_t>(first + i);
      }
    }
  }
  return nearest;
}

}  // namespace monoloc
