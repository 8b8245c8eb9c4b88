// Calls one kernel, or one function of the core, again and again, for arm_instructions.py to count its instructions.
//
//     arm_instructions list
//     arm_instructions loop ROUNDS             a loop of four instructions a round
//     arm_instructions kernel NAME ROUNDS      on values that are made up here
//     arm_instructions calls FILE ROUNDS       the recorded calls of one function
//
// FILE: the function's name, padded to 32 bytes; then for each call the number of its arguments, and for each argument
// its length in bytes and its bytes; numbers have 64 bits.
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <functional>
#include <map>
#include <memory>
#include <numeric>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

#include "monoloc/drawing.hpp"
#include "monoloc/index.hpp"
#include "monoloc/kernels.hpp"
#include "monoloc/landmark_consensus.hpp"
#include "monoloc/landmark_pose.hpp"
#include "monoloc/matching.hpp"
#include "monoloc/pooling.hpp"
#include "monoloc/rays.hpp"
#include "monoloc/rigid_motion.hpp"
#include "monoloc/window.hpp"
#include "room.hpp"

namespace {

using Work = std::function<void()>;

constexpr std::size_t kComponents = 200, kPoints = 200, kMany = 4096;
constexpr std::size_t kFrames = 12;  // keyframes of odometry
constexpr std::size_t kUnknowns = 6 * (kFrames - 1);
constexpr std::size_t kFew = 32;  // particles at which components are selected
constexpr std::size_t kListed = 50, kChosen = 11;  // components of a shortlist, and along a ray
constexpr std::size_t kChannels = 24, kColumns = 80, kRows = 60;  // of a pooled image

// --- Kernels ---

std::vector<float> floats(std::size_t count, float low, float high) {
  std::mt19937_64 random(count);
  std::uniform_real_distribution<float> any(low, high);
  std::vector<float> values(count);
  for (float& value : values) value = any(random);
  return values;
}

std::vector<double> doubles(std::size_t count, double low, double high) {
  const std::vector<float> values = floats(count, static_cast<float>(low), static_cast<float>(high));
  return {values.begin(), values.end()};
}

const monoloc::Kernels& kernels() { return monoloc::kernels(); }

const Room& room() {
  static const Room made(kComponents);
  return made;
}

// Of few components: the index is made in the emulator, too.
const monoloc::MixtureIndex& room_index() {
  static const monoloc::MixtureIndex made(Room(20).components, {0.2, 0.01, 0.02});
  return made;
}

// Rows of points near the room's surfaces.
std::vector<float> seen(std::size_t count) {
  const std::vector<double> points = room().points(count, 0.05);
  std::vector<float> rows(3 * count);
  for (std::size_t i = 0; i < points.size(); ++i) rows[i % 3 * count + i / 3] = static_cast<float>(points[i]);
  return rows;
}

// `rows` rows of particles without rotation, and with little else.
std::vector<float> particles(std::size_t rows, std::size_t stride) {
  std::vector<float> values = floats(rows * stride, -0.05f, 0.05f);
  for (const std::size_t diagonal : {0, 4, 8}) {
    for (std::size_t n = 0; n < stride; ++n) values[diagonal * stride + n] += 1.0f;
  }
  return values;
}

struct Rays {
  std::vector<float> whiten, means, log2_peak;

  Rays() {
    for (const monoloc::Component& c : room().components) {
      for (const double w : c.whiten) whiten.push_back(static_cast<float>(w));
      for (const double m : c.mean) means.push_back(static_cast<float>(m));
      log2_peak.push_back(static_cast<float>(c.log2_peak));
    }
  }

  monoloc::RayView view() const { return {whiten.data(), means.data(), log2_peak.data(), kComponents}; }

  std::vector<float> offsets(std::size_t stride) const {
    std::vector<float> out(3 * stride * kComponents);
    kernels().ray_offsets(view(), floats(3 * stride, -3.1f, -2.9f).data(), stride, out.data());
    return out;
  }
};

Work weigh() {
  const std::size_t stride = 304;
  return [=, from = particles(12, stride), scan = seen(kPoints), weights = floats(kPoints, 0.5f, 1.0f),
          out = std::vector<double>(stride)]() mutable {
    kernels().weigh(room_index().view(), from.data(), stride, scan.data(), weights.data(), kPoints, 0.7f, 0.01f,
                    out.data());
  };
}

Work density() {
  return [points = seen(kMany), out = std::vector<float>(kMany)]() mutable {
    kernels().density(room_index().view(), points.data(), kMany, out.data());
  };
}

Work component_density() {
  return [offsets = floats(3 * kMany, -0.1f, 0.1f), out = std::vector<float>(kMany),
          total = std::vector<float>(kMany)]() mutable {
    kernels().component_density(room().components[0], room().means.data(), offsets.data(), kMany, out.data(),
                                total.data());
  };
}

Work divide() {
  return [values = floats(kMany, 0.0f, 1.0f), total = floats(kMany, 1.0f, 2.0f)]() mutable {
    kernels().divide(values.data(), total.data(), kMany);
  };
}

Work largest_sum() {
  return [a = floats(kMany, 0.0f, 1.0f), b = floats(kMany, 1.0f, 2.0f)] {
    kernels().largest_sum(a.data(), b.data(), kMany);
  };
}

std::vector<double> exact_rows(std::size_t count) {
  const std::vector<float> rows = seen(count);
  return {rows.begin(), rows.end()};
}

constexpr std::size_t kExact = 1024;

Work log_density() {
  return [points = exact_rows(kExact), scratch = std::vector<double>(kComponents * monoloc::kPadding),
          out = std::vector<double>(kExact)]() mutable {
    kernels().log_density(room().components.data(), kComponents, points.data(), kExact, scratch.data(), out.data());
  };
}

Work expectation() {
  return [points = exact_rows(kExact), valid = std::vector<double>(kExact, 1.0),
          scratch = std::vector<double>(kComponents * monoloc::kPadding),
          active = std::vector<std::uint32_t>(kComponents),
          sums = std::vector<double>(10 * kComponents * monoloc::kPadding), largest = std::vector<double>(kExact),
          relative = std::vector<double>(kExact)]() mutable {
    kernels().expectation(room().components.data(), kComponents, points.data(), valid.data(), kExact, scratch.data(),
                          active.data(), sums.data(), largest.data(), relative.data());
  };
}

Work ray_offsets() {
  const std::size_t stride = monoloc::kRayBatch;
  return [=, rays = Rays(), centres = floats(3 * stride, -3.1f, -2.9f),
          out = std::vector<float>(3 * stride * kComponents)]() mutable {
    kernels().ray_offsets(rays.view(), centres.data(), stride, out.data());
  };
}

Work ray_shortlist() {
  const std::size_t stride = 208;  // padded
  std::vector<float> rows(13 * stride, 1.0f);  // whiten, offsets, log2_peak, norm, least, reach
  const Rays rays;
  for (std::size_t k = 0; k < kComponents; ++k) {
    for (std::size_t i = 0; i < 6; ++i) rows[i * stride + k] = rays.whiten[6 * k + i];
    for (std::size_t i = 0; i < 3; ++i) rows[(6 + i) * stride + k] = 10.0f * rays.means[3 * k + i];
    rows[9 * stride + k] = rays.log2_peak[k];
    rows[10 * stride + k] = 60.0f;
  }
  return [=, scratch = std::vector<float>(stride), out = std::vector<std::uint32_t>(stride + 1)]() mutable {
    const float* at = rows.data();
    const float ray[3] = {0.1f, 0.2f, 1.0f};
    kernels().ray_shortlist({at, at + 6 * stride, at + 9 * stride, at + 10 * stride, at + 11 * stride,
                             at + 12 * stride, stride, 0.05f, 0.02f},
                            ray, -17.0f, scratch.data(), out.data());
  };
}

Work ray_candidates() {
  const Rays rays;
  std::vector<std::uint32_t> listed(kListed);
  std::iota(listed.begin(), listed.end(), 0u);
  return [=, turns = particles(10, kFew), offsets = rays.offsets(kFew), scratch = std::vector<float>(kListed * kFew),
          out = std::vector<std::uint32_t>(kListed + 1)]() mutable {
    kernels().ray_candidates(rays.view(), turns.data(), offsets.data(), kFew, 0.1f, 0.2f, -17.0f, listed.data(),
                             kListed, scratch.data(), out.data());
  };
}

Work weigh_rays() {
  const std::size_t stride = monoloc::kRayBatch;
  const Rays rays;
  std::vector<std::uint32_t> chosen(kPoints * kChosen);
  std::vector<std::size_t> first(kPoints + 1);
  for (std::size_t i = 0; i < chosen.size(); ++i) chosen[i] = static_cast<std::uint32_t>(7 * i % kComponents);
  for (std::size_t p = 0; p <= kPoints; ++p) first[p] = p * kChosen;
  std::vector<float> scan = floats(3 * kPoints, -0.3f, 0.3f);
  for (std::size_t p = 0; p < kPoints; ++p) scan[2 * kPoints + p] += 3.0f;
  return [=, from = particles(10, stride), offsets = rays.offsets(stride), weights = floats(kPoints, 0.5f, 1.0f),
          scratch = std::vector<float>(3 * monoloc::kPadding * kComponents),
          out = std::vector<double>(stride)]() mutable {
    kernels().weigh_rays(rays.view(), from.data(), offsets.data(), scan.data(), weights.data(), kPoints,
                         chosen.data(), first.data(), 0.08f, 0.7f, 0.075f, scratch.data(), out.data());
  };
}

constexpr monoloc::ImageShape kPooled{kRows, kColumns, kChannels};
constexpr std::size_t kBlock = kRows * kColumns * monoloc::kPoolLanes;
constexpr std::size_t kStages = 4;

Work pool_block() {
  return [values = floats(kBlock, 0.0f, 6.0f), largest = std::vector<float>(kBlock), along = std::vector<float>(kBlock),
          from = std::vector<std::int32_t>(kBlock), along_from = std::vector<std::int32_t>(kBlock)]() mutable {
    kernels().pool_block(values.data(), kRows, kColumns, largest.data(), from.data(), along.data(), along_from.data());
  };
}

Work chain_block() {
  return [values = floats(kBlock, 0.0f, 6.0f), weights = floats((kStages + 1) * monoloc::kPoolLanes, 0.0f, 0.3f),
          scratch = std::vector<float>(3 * kBlock), out = std::vector<float>(kBlock)]() mutable {
    kernels().chain_block(values.data(), kRows, kColumns, weights.data(), kStages, scratch.data(), out.data());
  };
}

Work chain_gradient_block() {
  const std::size_t weights = (kStages + 1) * monoloc::kPoolLanes;
  return [values = floats(kBlock, 0.0f, 6.0f), gradient = floats(kBlock, -1.0f, 1.0f), w = floats(weights, 0.0f, 0.3f),
          scratch = std::vector<float>((4 + kStages) * kBlock),
          places = std::vector<std::int32_t>((1 + kStages) * kBlock), out = std::vector<float>(kBlock),
          of_w = std::vector<float>(weights)]() mutable {
    kernels().chain_gradient_block(values.data(), gradient.data(), kRows, kColumns, w.data(), kStages, scratch.data(),
                                   places.data(), out.data(), of_w.data());
  };
}

Work linearise_window() {
  const std::size_t stride = monoloc::kPadding, row_stride = 80;
  std::vector<double> cameras(12 * kFrames), observations(6 * kFrames * stride, 1.0);
  for (std::size_t w = 0; w < kFrames; ++w) {
    for (const std::size_t diagonal : {0, 4, 8}) cameras[12 * w + diagonal] = 1.0;
    cameras[12 * w + 9] = -0.05 * static_cast<double>(w);
    for (std::size_t i = 0; i < 3 * stride; ++i) observations[6 * w * stride + i] = 0.01 * static_cast<double>(i);
  }
  return [=, points = doubles(3 * stride, 1.0, 2.0),
          poses = std::vector<double>(kFrames * monoloc::kPoseSums * stride),
          information = std::vector<double>(6 * stride), whiten = std::vector<double>(6 * stride),
          rows = std::vector<double>(3 * stride * row_stride),
          scratch = std::vector<double>(12 * kFrames * stride)]() mutable {
    kernels().linearise_window(
        {cameras.data(), observations.data(), points.data(), kFrames, stride, 500.0, 3.0}, 0,
        {poses.data(), information.data(), whiten.data(), rows.data(), row_stride, scratch.data()});
  };
}

Work add_gram() {
  const std::size_t count = 3 * monoloc::kPadding, columns = kUnknowns + 1, stride = 80;
  return [=, rows = doubles(count * stride, -1.0, 1.0), out = std::vector<double>(stride * stride)]() mutable {
    kernels().add_gram(rows.data(), count, columns, stride, out.data());
  };
}

Work similar_descriptors() {
  const std::size_t count = 512;
  std::vector<std::uint64_t> words(monoloc::kDescriptorWords * count);
  std::mt19937_64 random(3);
  for (auto& word : words) word = random();
  return [=, places = std::vector<std::uint32_t>(count), bits = std::vector<std::uint32_t>(count)]() mutable {
    kernels().similar_descriptors(words.data(), words.data(), count, 64, places.data(), bits.data());
  };
}

Work multiply_add() {
  return [out = std::vector<float>(monoloc::kPadding)]() mutable { kernels().multiply_add(1000, out.data()); };
}

// --- Functions that only builds call ---

Work max_pool() {
  return [values = floats(kPooled.values(), 0.0f, 6.0f), largest = std::vector<float>(kPooled.values()),
          from = std::vector<std::uint16_t>(kPooled.values())]() mutable {
    monoloc::max_pool(values.data(), 1, kPooled, 1, largest.data(), from.data());
  };
}

Work max_pool_gradient() {
  const std::vector<float> values = floats(kPooled.values(), 0.0f, 6.0f);
  std::vector<float> largest(values.size());
  std::vector<std::uint16_t> from(values.size());
  monoloc::max_pool(values.data(), 1, kPooled, 1, largest.data(), from.data());
  return [=, out = std::vector<float>(values.size())]() mutable {
    monoloc::max_pool_gradient(values.data(), from.data(), 1, kPooled, 1, out.data());
  };
}

Work draw_points() {
  const std::size_t count = 40000, rows = 240, columns = 320;
  return [=, points = room().points(count, 0.02), front = std::vector<std::uint32_t>(rows * columns),
          depth = std::vector<float>(rows * columns)]() mutable {
    const double pose[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 3, 0, 0, 0, 1};
    monoloc::draw_points(points.data(), count, pose, {280, 280, 160, 120, {0.01}, false}, {0.1, 2.0, 2.0, 3.0}, 0.05,
                         rows, columns, front.data(), depth.data());
  };
}

struct Kernel {
  const char *name, *size;
  Work (*made)();
};

const Kernel kKernels[] = {
    {"weigh_rays", "64 particles, 200 points, 11 components each", weigh_rays},
    {"ray_candidates", "1 ray, 32 particles, 50 components", ray_candidates},
    {"ray_shortlist", "1 ray, 208 components", ray_shortlist},
    {"ray_offsets", "64 particles, 200 components", ray_offsets},
    {"similar_descriptors", "1 descriptor, 512 others", similar_descriptors},
    {"linearise_window", "16 corners, 12 keyframes", linearise_window},
    {"add_gram", "48 rows, 67 columns", add_gram},
    {"weigh", "304 particles, 200 points, 20 components, voxels of 20 cm", weigh},
    {"density", "4096 points, 20 components, voxels of 20 cm", density},
    {"component_density", "4096 points", component_density},
    {"divide", "4096 values", divide},
    {"largest_sum", "4096 values", largest_sum},
    {"log_density", "1024 points, 200 components", log_density},
    {"expectation", "1024 points, 200 components", expectation},
    {"pool_block", "80x60 pixels, 8 channels", pool_block},
    {"chain_block", "80x60 pixels, 8 channels, 4 stages", chain_block},
    {"chain_gradient_block", "80x60 pixels, 8 channels, 4 stages", chain_gradient_block},
    {"multiply_add", "1000 rounds", multiply_add},
    {"max_pool", "80x60 pixels, 24 channels", max_pool},
    {"max_pool_gradient", "80x60 pixels, 24 channels", max_pool_gradient},
    {"draw_points", "40,000 points, 320x240 pixels", draw_points},
};

Work kernel(const std::string& name) {
  for (const Kernel& each : kKernels) {
    if (name == each.name) return each.made();
  }
  throw std::invalid_argument("no kernel is called " + name);
}

// --- Recorded calls ---

// Arguments in the order of the binding.
struct Call {
  std::vector<std::vector<double>> arguments;  // as memory that suits all types
  std::vector<std::size_t> bytes;

  template <class T = double>
  const T* at(std::size_t index) const {
    return bytes[index] == 0 ? nullptr : reinterpret_cast<const T*>(arguments[index].data());
  }
  template <class T = double>
  std::size_t count(std::size_t index, std::size_t each = 1) const {
    return bytes[index] / (each * sizeof(T));
  }
  double number(std::size_t index) const { return *at(index); }
};

using Shared = std::shared_ptr<const Call>;

monoloc::SeenLandmarks landmarks(const Call& call) {
  return {call.at(0), call.at(1), call.at(2), call.count(0, 3), call.number(6)};
}

Work weigh_call(const Shared& call) {
  const auto mixture = std::make_shared<monoloc::RayMixture>(
      monoloc::make_components(call->at(0), call->at(1), call->at(2), call->count(0)));
  return [call, mixture] {
    std::vector<double> out(call->count(4));
    mixture->weigh(call->at(3), call->at(4), out.size(), call->at<float>(5), call->at<float>(6),
                   call->count<float>(5, 3), {call->number(7), call->number(8), call->number(9)}, out.data());
  };
}

Work adjust_call(const Shared& call) {
  return [call] {
    std::vector<double> poses = call->arguments[0], points = call->arguments[1], information(3 * points.size());
    const std::size_t corners = points.size() / 3, frames = poses.size() / 16;
    monoloc::adjust_window({call->at(2), call->at(3), corners, frames, call->number(4), call->number(5)},
                           static_cast<std::size_t>(call->number(6)), poses.data(), points.data(),
                           information.data());
  };
}

const std::map<std::string, std::function<void(const Call&)>> kFunctions = {
    {"se3_exp",
     [](const Call& call) {
       std::vector<double> poses(16 * call.count(0, 6));
       monoloc::se3_exp(call.at(0), call.count(0, 6), poses.data());
     }},
    {"se3_log",
     [](const Call& call) {
       std::vector<double> twists(6 * call.count(0, 16));
       monoloc::se3_log(call.at(0), call.count(0, 16), twists.data());
     }},
    {"pose_distances",
     [](const Call& call) {
       std::vector<double> distances(call.count(1, 16));
       monoloc::pose_distances(call.at(0), call.at(1), distances.size(), call.number(2), distances.data());
     }},
    {"match_descriptors",
     [](const Call& call) {
       monoloc::match_descriptors({call.at(0), call.at<std::uint8_t>(1), call.count(0, 2)},
                                  {call.at(2), call.at<std::uint8_t>(3), call.count(2, 2)}, call.number(4),
                                  static_cast<int>(call.number(5)));
     }},
    {"nearest_descriptors",
     [](const Call& call) {
       const auto of = [&call](std::size_t i) -> monoloc::Descriptors {
         return {call.at<std::uint8_t>(i), call.count<std::uint8_t>(i, monoloc::kDescriptorBytes)};
       };
       monoloc::nearest_descriptors(of(0), of(1), static_cast<std::size_t>(call.number(2)),
                                     static_cast<int>(call.number(3)));
     }},
    {"find_consensus",
     [](const Call& call) {
       const monoloc::SeenLandmarks seen{call.at(0), call.at(1), call.at(2), call.count(0, 3), call.number(3)};
       monoloc::find_consensus(seen, call.number(4), static_cast<std::size_t>(call.number(5)), call.number(6));
     }},
    {"fit_pose",
     [](const Call& call) {
       monoloc::fit_pose(landmarks(call), call.at(3), call.at(4), {call.at(5), call.count(5)});
     }},
    {"leverages",
     [](const Call& call) { monoloc::leverages(landmarks(call), call.at(3), call.at(4), call.at(5)); }},
    {"fit_log_focal",
     [](const Call& call) {
       monoloc::fit_log_focal(landmarks(call), call.at(3), call.at(4), {call.at(5), call.count(5)});
     }},
    {"fit_log_aspect",
     [](const Call& call) {
       monoloc::fit_log_aspect(landmarks(call), call.at(3), call.at(4), {call.at(5), call.count(5)});
     }},
};

Work prepared(const std::string& function, const Shared& call) {
  if (function == "RayMixture.weigh") return weigh_call(call);
  if (function == "adjust_window") return adjust_call(call);
  return [call, run = kFunctions.at(function)] { run(*call); };
}

std::uint64_t read_number(std::istream& file) {
  std::uint64_t value = 0;
  file.read(reinterpret_cast<char*>(&value), sizeof value);
  return value;
}

Work recorded(const char* path) {
  std::ifstream file(path, std::ios::binary);
  char name[33] = {};
  if (!file.read(name, 32)) throw std::invalid_argument(std::string("cannot read ") + path);
  std::vector<Work> calls;
  for (std::uint64_t left = read_number(file); file; left = read_number(file)) {
    const auto call = std::make_shared<Call>();
    for (; left > 0; --left) {
      const std::size_t bytes = read_number(file);
      call->bytes.push_back(bytes);
      call->arguments.emplace_back((bytes + sizeof(double) - 1) / sizeof(double));
      file.read(reinterpret_cast<char*>(call->arguments.back().data()), static_cast<std::streamsize>(bytes));
    }
    calls.push_back(prepared(name, call));
  }
  return [calls] {
    for (const Work& call : calls) call();
  };
}

// --- Command line ---

void loop(std::uint64_t rounds) {
#ifdef __aarch64__
  __asm__ volatile("1: add x9, x9, #1\n nop\n subs %0, %0, #1\n b.ne 1b" : "+r"(rounds) : : "x9", "cc");
#else
  (void)rounds;
#endif
}

int list() {
  for (const Kernel& each : kKernels) std::printf("%s\t%s\n", each.name, each.size);
  return 0;
}

int run(const std::vector<std::string>& words) {
  if (words == std::vector<std::string>{"list"}) return list();
  if (words.size() < 2) throw std::invalid_argument("see the head of arm_instructions.cpp");
  const auto rounds = static_cast<std::uint64_t>(std::strtoull(words.back().c_str(), nullptr, 10));
  if (words[0] == "loop") {
    loop(rounds);
    return 0;
  }
  const Work work = words[0] == "kernel" ? kernel(words[1]) : recorded(words[1].c_str());
  for (std::uint64_t round = 0; round < rounds; ++round) work();
  return 0;
}

}  // namespace

int main(int count, char** words) {
  try {
    return run({words + 1, words + count});
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 2;
  }
}
