// Converts types, and checks that lengths agree. Python checks shapes first, where the messages name the argument.
#include <nanobind/stl/optional.h>

#include <cstdint>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

#include "arrays.hpp"
#include "monoloc/drawing.hpp"
#include "monoloc/index.hpp"
#include "monoloc/landmark_consensus.hpp"
#include "monoloc/landmark_pose.hpp"
#include "monoloc/matching.hpp"
#include "monoloc/mixture.hpp"
#include "monoloc/rays.hpp"
#include "monoloc/rigid_motion.hpp"
#include "monoloc/window.hpp"

using namespace nb::literals;

namespace {

using Scalars = Array<double, nb::shape<-1>>;
using Vectors = Array<double, nb::shape<-1, 3>>;
using Matrices = Array<double, nb::shape<-1, 3, 3>>;
using Poses = Array<double, nb::shape<-1, 4, 4>>;
using Floats = Array<float, nb::shape<-1>>;
using FloatVectors = Array<float, nb::shape<-1, 3>>;
using WritableNumbers = nb::ndarray<std::uint32_t, nb::shape<-1, -1>, nb::c_contig, nb::device::cpu>;
using WritableDepth = nb::ndarray<float, nb::shape<-1, -1>, nb::c_contig, nb::device::cpu>;
template <long size>
using Square = Array<double, nb::shape<size, size>>;
using Pose = Square<4>;
using Twists = Array<double, nb::shape<-1, 6>>;
using Pixels = Array<double, nb::shape<-1, 2>>;
using Descriptors = Array<std::uint8_t, nb::shape<-1, monoloc::kDescriptorBytes>>;
using Result = nb::ndarray<nb::numpy, double>;

// A NumPy array that owns the values.
template <class T>
nb::ndarray<nb::numpy, T> to_numpy(std::vector<T> values, std::initializer_list<std::size_t> shape) {
  auto kept = std::make_unique<std::vector<T>>(std::move(values));
  T* data = kept->data();
  nb::capsule owner(kept.release(), [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return nb::ndarray<nb::numpy, T>(data, shape, owner);
}

// Calls Python's signal handlers, which otherwise wait until a call returns. A map of a floor takes half a minute.
void handle_signals() {
  nb::gil_scoped_acquire acquire;
  if (PyErr_CheckSignals() != 0) throw nb::python_error();
}

std::vector<monoloc::Component> components(const Scalars& weights, const Vectors& means, const Matrices& covariances) {
  const std::size_t count = weights.shape(0);
  require(means.shape(0) == count && covariances.shape(0) == count,
          "weights, means and covariances must be of one number of components");
  return monoloc::make_components(weights.data(), means.data(), covariances.data(), weights.shape(0));
}

Result log_density(const Vectors& points, const Scalars& weights, const Vectors& means, const Matrices& covariances) {
  const std::size_t count = points.shape(0);
  std::vector<double> out(count);
  {
    nb::gil_scoped_release release;
    monoloc::log_density(components(weights, means, covariances), points.data(), count, out.data());
  }
  return to_numpy(std::move(out), {count});
}

nb::tuple expectation(const Vectors& points, const Scalars& weights, const Vectors& means,
                      const Matrices& covariances) {
  const std::size_t count = weights.shape(0);
  monoloc::Expectation e;
  {
    nb::gil_scoped_release release;
    e = monoloc::expectation(components(weights, means, covariances), points.data(), points.shape(0));
  }
  return nb::make_tuple(to_numpy(std::move(e.mass), {count}), to_numpy(std::move(e.first), {count, 3}),
                        to_numpy(std::move(e.second), {count, 6}), e.log_likelihood);
}

Result index_log_density(const monoloc::MixtureIndex& index, const Vectors& points) {
  const std::size_t count = points.shape(0);
  std::vector<double> out(count);
  {
    nb::gil_scoped_release release;
    index.log_density(points.data(), count, out.data());
  }
  return to_numpy(std::move(out), {count});
}

// Of particles and scans: one log-scale a pose, and one weight a point, if there are weights.
void require_lengths(const Poses& poses, const Scalars& log_scales, const FloatVectors& scan,
                     const std::optional<Floats>& point_weights) {
  require(log_scales.shape(0) == poses.shape(0), "poses and log_scales must be of one number");
  require(!point_weights || point_weights->shape(0) == scan.shape(0), "scan and point_weights must be of one number");
}

Result index_weigh(const monoloc::MixtureIndex& index, const Poses& poses, const Scalars& log_scales,
                   const FloatVectors& scan, const std::optional<Floats>& point_weights, double outlier_share,
                   double volume_m3) {
  require_lengths(poses, log_scales, scan, point_weights);
  const std::size_t count = poses.shape(0);
  std::vector<double> out(count);
  {
    nb::gil_scoped_release release;
    index.weigh(poses.data(), log_scales.data(), count, scan.data(), point_weights ? point_weights->data() : nullptr,
                scan.shape(0), outlier_share, volume_m3, out.data());
  }
  return to_numpy(std::move(out), {count});
}

Result rays_weigh(const monoloc::RayMixture& mixture, const Poses& poses, const Scalars& log_scales,
                  const FloatVectors& scan, const std::optional<Floats>& point_weights, double log_depth_sd,
                  double outlier_share, double log_depth_range) {
  require_lengths(poses, log_scales, scan, point_weights);
  const std::size_t count = poses.shape(0);
  std::vector<double> out(count);
  {
    nb::gil_scoped_release release;
    mixture.weigh(poses.data(), log_scales.data(), count, scan.data(), point_weights ? point_weights->data() : nullptr,
                  scan.shape(0), {log_depth_sd, outlier_share, log_depth_range}, out.data());
  }
  return to_numpy(std::move(out), {count});
}

void draw_points(const Vectors& points, const Pose& camera_from_world, const Array<double, nb::shape<12>>& camera,
                 bool is_fisheye, const Array<double, nb::shape<4>>& sight, double behind, const WritableNumbers& front,
                 const WritableDepth& depth) {
  require_same_shape(front, depth, "front and depth must have one shape");
  const double *c = camera.data(), *s = sight.data();
  nb::gil_scoped_release release;
  monoloc::draw_points(points.data(), points.shape(0), camera_from_world.data(),
                       {c[0], c[1], c[2], c[3], {c[4], c[5], c[6], c[7], c[8], c[9], c[10], c[11]}, is_fisheye},
                       {s[0], s[1], s[2], s[3]}, behind,
                       front.shape(0), front.shape(1), front.data(), depth.data());
}

nb::tuple match_descriptors(const Pixels& expected, const Descriptors& known, const Pixels& pixels,
                            const Descriptors& descriptors, double radius_px, int most_bits) {
  require(known.shape(0) == expected.shape(0), "expected and known must be of one number");
  require(descriptors.shape(0) == pixels.shape(0), "pixels and descriptors must be of one number");
  monoloc::Matches matches;
  {
    nb::gil_scoped_release release;
    matches = monoloc::match_descriptors({expected.data(), known.data(), expected.shape(0)},
                                         {pixels.data(), descriptors.data(), pixels.shape(0)}, radius_px, most_bits);
  }
  const std::size_t count = matches.landmarks.size();
  return nb::make_tuple(to_numpy(std::move(matches.landmarks), {count}),
                        to_numpy(std::move(matches.keypoints), {count}));
}

nb::tuple nearest_descriptors(const Descriptors& descriptors, const Descriptors& known, std::size_t kept,
                              int most_bits) {
  require(kept <= known.shape(0), "kept must be at most the number of known descriptors");
  monoloc::Nearest nearest;
  {
    nb::gil_scoped_release release;
    nearest = monoloc::nearest_descriptors({descriptors.data(), descriptors.shape(0)}, {known.data(), known.shape(0)},
                                           kept, most_bits);
  }
  const std::size_t count = descriptors.shape(0);
  return nb::make_tuple(to_numpy(std::move(nearest.bits), {count, kept}),
                        to_numpy(std::move(nearest.known), {count, kept}));
}

monoloc::SeenLandmarks seen_landmarks(const Vectors& points, const Pixels& rays, const Pixels& sd,
                                      const Scalars& kernel_sds, double nearest_m) {
  const std::size_t count = points.shape(0);
  require(rays.shape(0) == count && sd.shape(0) == count, "points, rays and sd must be of one number");
  require(kernel_sds.shape(0) > 0, "kernel_sds must have an entry");
  return {points.data(), rays.data(), sd.data(), count, nearest_m};
}

nb::tuple fit_pose(const Vectors& points, const Pixels& rays, const Pixels& sd, const Pose& prior,
                   const Square<6>& information, const Scalars& kernel_sds, double nearest_m) {
  const monoloc::SeenLandmarks seen = seen_landmarks(points, rays, sd, kernel_sds, nearest_m);
  monoloc::PoseFit fit;
  {
    nb::gil_scoped_release release;
    fit = monoloc::fit_pose(seen, prior.data(), information.data(), {kernel_sds.data(), kernel_sds.shape(0)});
  }
  return nb::make_tuple(to_numpy(std::vector<double>(fit.pose, fit.pose + 16), {4, 4}),
                        to_numpy(std::vector<double>(fit.normal, fit.normal + 36), {6, 6}),
                        to_numpy(std::vector<double>(fit.gradient, fit.gradient + 6), {6}),
                        to_numpy(std::move(fit.weights), {seen.count}));
}

auto leverages(const Vectors& points, const Pixels& rays, const Pixels& sd, const Pose& pose,
               const Square<6>& covariance, const Scalars& weights, double nearest_m) {
  const std::size_t count = points.shape(0);
  require(rays.shape(0) == count && sd.shape(0) == count && weights.shape(0) == count,
          "points, rays, sd and weights must be of one number");
  std::vector<double> found;
  {
    nb::gil_scoped_release release;
    found = monoloc::leverages({points.data(), rays.data(), sd.data(), count, nearest_m}, pose.data(),
                               covariance.data(), weights.data());
  }
  return to_numpy(std::move(found), {count});
}

using LensFit = monoloc::LogRatio (*)(const monoloc::SeenLandmarks&, const double*, const double*,
                                      const monoloc::KernelSchedule&);

template <std::size_t unknowns, LensFit fit_lens>
nb::tuple fitted_lens(const Vectors& points, const Pixels& rays, const Pixels& sd, const Pose& pose,
                      const Square<unknowns>& information, const Scalars& kernel_sds, double nearest_m) {
  const monoloc::SeenLandmarks seen = seen_landmarks(points, rays, sd, kernel_sds, nearest_m);
  monoloc::LogRatio fit;
  {
    nb::gil_scoped_release release;
    fit = fit_lens(seen, pose.data(), information.data(), {kernel_sds.data(), kernel_sds.shape(0)});
  }
  return nb::make_tuple(fit.value, fit.sd);
}

nb::tuple find_consensus(const Vectors& points, const Pixels& rays, const Pixels& sd, double nearest_m, double most_sd,
                         std::size_t most_triples, double confidence) {
  const std::size_t count = points.shape(0);
  require(rays.shape(0) == count && sd.shape(0) == count, "points, rays and sd must be of one number");
  monoloc::Consensus found;
  {
    nb::gil_scoped_release release;
    found = monoloc::find_consensus({points.data(), rays.data(), sd.data(), count, nearest_m}, most_sd, most_triples,
                                    confidence);
  }
  const std::size_t agreeing = found.agreeing.size();
  return nb::make_tuple(to_numpy(std::vector<double>(found.pose, found.pose + 16), {4, 4}),
                        to_numpy(std::move(found.agreeing), {agreeing}));
}

nb::tuple adjust_window(const Poses& poses, const Vectors& points, const Array<double, nb::shape<-1, -1, 2>>& rays,
                        const Array<double, nb::shape<-1, -1>>& log_depth, double ray_sd, double log_depth_sd,
                        std::size_t iterations) {
  const std::size_t corners = points.shape(0), frames = poses.shape(0);
  require(rays.shape(0) == corners && log_depth.shape(0) == corners,
          "points, rays and log_depth must be of one number");
  require(rays.shape(1) == frames && log_depth.shape(1) == frames, "poses, rays and log_depth must be of one number");
  std::vector<double> moved(poses.data(), poses.data() + 16 * frames);
  std::vector<double> placed(points.data(), points.data() + 3 * corners), information(9 * corners, 0.0);
  {
    nb::gil_scoped_release release;
    monoloc::adjust_window({rays.data(), log_depth.data(), corners, frames, ray_sd, log_depth_sd}, iterations,
                           moved.data(), placed.data(), information.data());
  }
  return nb::make_tuple(to_numpy(std::move(moved), {frames, 4, 4}), to_numpy(std::move(placed), {corners, 3}),
                        to_numpy(std::move(information), {corners, 3, 3}));
}

Result se3_exp(const Twists& twists) {
  std::vector<double> poses(16 * twists.shape(0));
  monoloc::se3_exp(twists.data(), twists.shape(0), poses.data());
  return to_numpy(std::move(poses), {twists.shape(0), 4, 4});
}

Result se3_log(const Poses& poses) {
  std::vector<double> twists(6 * poses.shape(0));
  monoloc::se3_log(poses.data(), poses.shape(0), twists.data());
  return to_numpy(std::move(twists), {poses.shape(0), 6});
}

Result pose_distances(const Pose& pose, const Poses& others, double turn_worth) {
  std::vector<double> distances(others.shape(0));
  monoloc::pose_distances(pose.data(), others.data(), others.shape(0), turn_worth, distances.data());
  return to_numpy(std::move(distances), {others.shape(0)});
}

}  // namespace

NB_MODULE(_core, m) {
  m.doc() =
      "Native kernels of monoloc: mixture density, E-step of EM, weighing of particles, max-pooling, drawing of "
      "points, matching of descriptors, poses of landmarks, bundle adjustment, rigid motions.";
  m.def("se3_exp", &se3_exp, "twists"_a);
  m.def("se3_log", &se3_log, "poses"_a);
  m.def("pose_distances", &pose_distances, "pose"_a, "others"_a, "turn_worth"_a);
  m.def("log_density", &log_density, "points"_a, "weights"_a, "means"_a, "covariances"_a);
  m.def("expectation", &expectation, "points"_a, "weights"_a, "means"_a, "covariances"_a);
  define_pooling(m);
  m.def("draw_points", &draw_points, "points"_a, "camera_from_world"_a, "camera"_a, "is_fisheye"_a, "sight"_a,
        "behind"_a, "front"_a.noconvert(), "depth"_a.noconvert());
  m.def("match_descriptors", &match_descriptors, "expected"_a, "known"_a, "pixels"_a, "descriptors"_a, "radius_px"_a,
        "most_bits"_a);
  m.def("nearest_descriptors", &nearest_descriptors, "descriptors"_a, "known"_a, "kept"_a, "most_bits"_a);
  m.def("find_consensus", &find_consensus, "points"_a, "rays"_a, "sd"_a, "nearest_m"_a, "most_sd"_a,
        "most_triples"_a, "confidence"_a);
  m.def("fit_pose", &fit_pose, "points"_a, "rays"_a, "sd"_a, "prior"_a, "information"_a, "kernel_sds"_a,
        "nearest_m"_a);
  m.def("leverages", &leverages, "points"_a, "rays"_a, "sd"_a, "pose"_a, "covariance"_a, "weights"_a, "nearest_m"_a);
  m.def("fit_log_focal", &fitted_lens<7, monoloc::fit_log_focal>, "points"_a, "rays"_a, "sd"_a, "pose"_a,
        "information"_a, "kernel_sds"_a, "nearest_m"_a);
  m.def("fit_log_aspect", &fitted_lens<8, monoloc::fit_log_aspect>, "points"_a, "rays"_a, "sd"_a, "pose"_a,
        "information"_a, "kernel_sds"_a, "nearest_m"_a);
  m.def("adjust_window", &adjust_window, "poses"_a, "points"_a, "rays"_a, "log_depth"_a, "ray_sd"_a,
        "log_depth_sd"_a, "iterations"_a);
  m.def("instruction_set", [] { return monoloc::kernels().name; });
  m.def(
      "multiply_add",
      [](std::size_t rounds) {
        float out[monoloc::kPadding];
        return monoloc::kernels().multiply_add(rounds, out);
      },
      "rounds"_a);
  nb::class_<monoloc::MixtureIndex>(m, "MixtureIndex")
      .def(
          "__init__",
          [](monoloc::MixtureIndex* self, const Scalars& weights, const Vectors& means, const Matrices& covariances,
             double voxel_m, double floor_density, double tolerance) {
            nb::gil_scoped_release release;
            new (self) monoloc::MixtureIndex(components(weights, means, covariances),
                                             {voxel_m, floor_density, tolerance, std::thread::hardware_concurrency(),
                                              handle_signals});
          },
          "weights"_a, "means"_a, "covariances"_a, "voxel_m"_a, "floor_density"_a, "tolerance"_a)
      .def("log_density", &index_log_density, "points"_a)
      .def(
          "evaluations",
          [](const monoloc::MixtureIndex& self, const Vectors& points) {
            return self.evaluations(points.data(), points.shape(0));
          },
          "points"_a)
      .def("weigh", &index_weigh, "poses"_a, "log_scales"_a, "scan"_a, "point_weights"_a.none(), "outlier_share"_a,
           "volume_m3"_a)
      .def_prop_ro("voxel_m", &monoloc::MixtureIndex::voxel_m)
      .def_prop_ro("voxels", &monoloc::MixtureIndex::voxels)
      .def_prop_ro("lists", &monoloc::MixtureIndex::lists)
      .def_prop_ro("mean_candidates", &monoloc::MixtureIndex::mean_candidates)
      .def_prop_ro("nbytes", &monoloc::MixtureIndex::bytes);
  nb::class_<monoloc::RayMixture>(m, "RayMixture")
      .def(
          "__init__",
          [](monoloc::RayMixture* self, const Scalars& weights, const Vectors& means, const Matrices& covariances) {
            new (self) monoloc::RayMixture(components(weights, means, covariances));
          },
          "weights"_a, "means"_a, "covariances"_a)
      .def("weigh", &rays_weigh, "poses"_a, "log_scales"_a, "scan"_a, "point_weights"_a.none(), "log_depth_sd"_a,
           "outlier_share"_a, "log_depth_range"_a);
}
