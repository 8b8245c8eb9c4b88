#include "monoloc/matching.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <numeric>

namespace monoloc {
namespace {

using Descriptor = std::array<std::uint64_t, kDescriptorBytes / sizeof(std::uint64_t)>;

Descriptor descriptor_of(const Corners& corners, std::size_t index) {
  Descriptor words;
  std::memcpy(words.data(), corners.descriptors + kDescriptorBytes * index, kDescriptorBytes);
  return words;
}

// Number of bits in which two descriptors differ. Ones are counted in fields of 2, 4 and 8 bits (Warren, Hacker's
// Delight, section 5-1), because an instruction that counts them is not on every processor. The words' fields of 8 bits
// add up to at most 32, those of 16 bits to at most 256.
int differing_bits(const Descriptor& a, const Descriptor& b) {
  std::uint64_t bytes = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    std::uint64_t x = a[i] ^ b[i];
    x -= (x >> 1) & 0x5555555555555555u;
    x = (x & 0x3333333333333333u) + ((x >> 2) & 0x3333333333333333u);
    bytes += (x + (x >> 4)) & 0x0F0F0F0F0F0F0F0Fu;
  }
  const std::uint64_t pairs = (bytes & 0x00FF00FF00FF00FFu) + ((bytes >> 8) & 0x00FF00FF00FF00FFu);
  return static_cast<int>((pairs * 0x0001000100010001u) >> 48);
}

// Keypoints by increasing x.
struct Sorted {
  std::vector<std::size_t> index;
  std::vector<double> x, y;
  std::vector<Descriptor> descriptors;
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
    sorted.descriptors.push_back(descriptor_of(keypoints, i));
  }
  return sorted;
}

// The best match of a corner so far.
struct Best {
  int bits;
  std::size_t other;
};

}  // namespace

Matches match_descriptors(const Corners& landmarks, const Corners& keypoints, double radius_px, int most_bits) {
  const Sorted sorted = sorted_by_x(keypoints);
  const std::size_t none = sorted.index.size();
  std::vector<Best> of_landmark(landmarks.count, {most_bits, none});
  std::vector<Best> of_keypoint(sorted.index.size(), {most_bits, landmarks.count});
  std::vector<std::size_t> near(sorted.index.size());
  for (std::size_t i = 0; i < landmarks.count; ++i) {
    const double x = landmarks.pixels[2 * i], y = landmarks.pixels[2 * i + 1];
    if (std::isnan(x)) continue;
    const auto first = std::lower_bound(sorted.x.begin(), sorted.x.end(), x - radius_px);
    const auto last = std::lower_bound(first, sorted.x.end(), x + radius_px);
    std::size_t count = 0;
    for (auto place = static_cast<std::size_t>(first - sorted.x.begin());
         place < static_cast<std::size_t>(last - sorted.x.begin()); ++place) {
      near[count] = place;
      count += std::abs(y - sorted.y[place]) < radius_px;
    }
    const Descriptor known = descriptor_of(landmarks, i);
    for (std::size_t n = 0; n < count; ++n) {
      const std::size_t place = near[n];
      const int bits = differing_bits(known, sorted.descriptors[place]);
      if (bits < of_landmark[i].bits) of_landmark[i] = {bits, place};
      if (bits < of_keypoint[place].bits) of_keypoint[place] = {bits, i};
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
