// Matches of descriptors: mutual, near, and the first of several.
#include <algorithm>
#include <bitset>
#include <cstdint>
#include <limits>
#include <random>
#include <vector>

#include "check.hpp"
#include "monoloc/matching.hpp"
#include "tests.hpp"

namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr int kMostBits = 64;

// A corner whose descriptor begins with this many ones.
struct Corner {
  double x, y;
  int ones;
};

struct Image {
  std::vector<double> pixels;
  std::vector<std::uint8_t> descriptors;

  explicit Image(const std::vector<Corner>& all) {
    for (const Corner& corner : all) {
      pixels.insert(pixels.end(), {corner.x, corner.y});
      for (int bit = 0; bit < 256; bit += 8) {
        const int left = corner.ones - bit;
        descriptors.push_back(left >= 8 ? 255 : left <= 0 ? 0 : static_cast<std::uint8_t>((1 << left) - 1));
      }
    }
  }

  monoloc::Corners corners() const { return {pixels.data(), descriptors.data(), pixels.size() / 2}; }
};

using Indices = std::vector<std::int64_t>;

bool matched(const std::vector<Corner>& landmarks, const std::vector<Corner>& keypoints, const Indices& which,
             const Indices& where) {
  const monoloc::Matches found =
      monoloc::match_descriptors(Image(landmarks).corners(), Image(keypoints).corners(), 10.0, kMostBits);
  return found.landmarks == which && found.keypoints == where;
}

}  // namespace

void test_matching() {
  // Each takes its nearest; a landmark whose nearest keypoint has a nearer landmark takes none.
  CHECK(matched({{0, 0, 0}, {1, 0, 100}, {2, 0, 103}}, {{3, 0, 101}, {4, 0, 5}}, {0, 1}, {1, 0}));
  // Of several as near, the first landmark, and the keypoint with the least x, then the first.
  CHECK(matched({{0, 0, 2}, {1, 0, 2}}, {{3, 0, 1}, {2, 0, 3}, {2, 0, 1}}, {0}, {1}));
  CHECK(matched({{0, 0, 2}}, {{2, -9, 1}, {2, 9, 3}, {3, 0, 1}, {1.5, 9, 1}, {1.5, -9, 3}}, {0}, {3}));
  // Descriptors that differ too much, also in all bits.
  CHECK(matched({{0, 0, 0}}, {{0, 0, 63}}, {0}, {0}));
  for (const int ones : {64, 128, 255, 256}) CHECK(matched({{0, 0, 0}}, {{0, 0, ones}}, {}, {}));
  // Pixels at the radius: on the left in, elsewhere out.
  CHECK(matched({{0, 0, 0}}, {{-10, 0, 0}}, {0}, {0}));
  for (const Corner& far : {Corner{10, 0, 0}, {0, 10, 0}, {0, -10, 0}, {-10.1, 0, 0}}) {
    CHECK(matched({{0, 0, 0}}, {far}, {}, {}));
  }
  // NaN on either side, and nothing on either.
  const std::vector<Corner> unknown = {{kNaN, 0, 0}, {0, kNaN, 0}, {kNaN, kNaN, 0}};
  CHECK(matched(unknown, {{1, 0, 0}, {kNaN, 0, 0}}, {}, {}));
  CHECK(matched({{0, 0, 0}, {1, 0, 0}}, unknown, {}, {}));
  CHECK(matched({}, {{0, 0, 0}}, {}, {}));
  CHECK(matched({{0, 0, 0}}, {}, {}, {}));
}

void test_nearest_descriptors() {
  // Descriptor i of 600 differs from none in i / 2 bits, so two are always as near, and one block is not enough.
  std::vector<std::uint8_t> known(600 * monoloc::kDescriptorBytes, 0), one(monoloc::kDescriptorBytes, 0);
  for (std::size_t i = 0; i < 600; ++i) {
    const std::size_t ones = std::min<std::size_t>((599 - i) / 2, 256);
    for (std::size_t bit = 0; bit < ones; ++bit) known[i * monoloc::kDescriptorBytes + bit / 8] |= 1u << bit % 8;
  }
  const monoloc::Nearest nearest = monoloc::nearest_descriptors({one.data(), 1}, {known.data(), 600}, 5, 257);
  CHECK((nearest.bits == std::vector<std::int32_t>{0, 0, 1, 1, 2}));
  CHECK((nearest.known == std::vector<std::int64_t>{598, 599, 596, 597, 594}));
  CHECK(monoloc::nearest_descriptors({one.data(), 1}, {known.data(), 600}, 0, 257).bits.empty());
  const monoloc::Nearest few = monoloc::nearest_descriptors({one.data(), 1}, {known.data(), 600}, 5, 2);
  CHECK((few.bits == std::vector<std::int32_t>{0, 0, 1, 1, 257}));
  CHECK((few.known == std::vector<std::int64_t>{598, 599, 596, 597, 0}));
}

void test_similar_descriptors(const monoloc::Kernels& kernels) {
  constexpr std::size_t words = monoloc::kDescriptorWords, count = 23;
  std::mt19937_64 random(3);
  std::vector<std::uint64_t> one(words), others(words * count);
  for (auto& word : one) word = random();
  for (auto& word : others) word = random();
  for (std::size_t w = 0; w < words; ++w) {
    others[w] = ~one[w];  // all bits differ
    others[words * 9 + w] = others[words * (count - 1) + w] = one[w];
  }
  for (const std::uint32_t limit : {0u, 1u, 128u, 256u, 257u}) {
    std::vector<std::uint32_t> expected_places, expected_bits, places(count), bits(count);
    for (std::size_t i = 0; i < count; ++i) {
      std::size_t differing = 0;
      for (std::size_t w = 0; w < words; ++w) differing += std::bitset<64>(one[w] ^ others[words * i + w]).count();
      if (differing >= limit) continue;
      expected_places.push_back(static_cast<std::uint32_t>(i));
      expected_bits.push_back(static_cast<std::uint32_t>(differing));
    }
    const std::size_t found =
        kernels.similar_descriptors(one.data(), others.data(), count, limit, places.data(), bits.data());
    places.resize(found);
    bits.resize(found);
    CHECK(places == expected_places && bits == expected_bits);
    CHECK(limit < 257 || bits.front() == 256);
  }
}
