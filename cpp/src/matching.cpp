#include "monoloc/matching.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "monoloc/kernels.hpp"

namespace monoloc {
namespace {

static_assert(kDescriptorBytes == kDescriptorWords * sizeof(std::uint64_t), "whole words");

void append_descriptor(const Corners& corners, std::size_t index, std::vector<std::uint64_t>& words) {
  words.resize(words.size() + kDescriptorWords);
  std::memcpy(words.data() + words.size() - kDescriptorWords, corners.descriptors + kDescriptorBytes * index,
              kDescriptorBytes);
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

}  // namespace monoloc
