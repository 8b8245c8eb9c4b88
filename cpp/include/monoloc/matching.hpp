// Matches landmarks with keypoints near their expected pixels.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace monoloc {

constexpr std::size_t kDescriptorBytes = 32;

// Corners with binary descriptors.
struct Corners {
  const double* pixels;             // (count, 2); a corner with a NaN matches none
  const std::uint8_t* descriptors;  // (count, kDescriptorBytes)
  std::size_t count;
};

struct Matches {
  std::vector<std::int64_t> landmarks, keypoints;  // their indices, by increasing landmark
};

// Mutual nearest neighbours, by the number of bits in which descriptors differ, among the pairs that differ by fewer
// than `most_bits`, and whose pixels differ by less than `radius_px` in x (on the left, also by as much) and in y. Of
// several keypoints as near to a landmark, the one with the least x counts, then the first; of several landmarks as
// near to a keypoint, the first.
Matches match_descriptors(const Corners& landmarks, const Corners& keypoints, double radius_px, int most_bits);

// Descriptors one after the other, kDescriptorBytes each.
struct Descriptors {
  const std::uint8_t* bytes;
  std::size_t count;
};

// Of each of N descriptors the `kept` nearest known ones that differ by fewer than `most_bits`, nearest first,
// (N, kept); of those as near, the first. Where there are fewer, the rest of a row has 257 bits and known 0.
struct Nearest {
  std::vector<std::int32_t> bits;  // by which they differ
  std::vector<std::int64_t> known;
};

// `kept` is at most the number of known descriptors.
Nearest nearest_descriptors(const Descriptors& descriptors, const Descriptors& known, std::size_t kept, int most_bits);

}  // namespace monoloc
