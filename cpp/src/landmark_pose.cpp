#include "monoloc/landmark_pose.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "linear_solve.hpp"
#include "monoloc/rigid_motion.hpp"

namespace monoloc {
namespace {

// Normal matrix and gradient of `size` unknowns.
template <std::size_t size>
struct NormalEquations {
  std::array<double, size * size> normal{};
  std::array<double, size> gradient{};

  // Adds a residual to gradient and upper triangle.
  void add(const std::array<double, size>& row, double weight, double residual) {
    for (std::size_t i = 0; i < size; ++i) {
      const double weighted = weight * row[i];
      gradient[i] += weighted * residual;
      for (std::size_t j = i; j < size; ++j) normal[i * size + j] += weighted * row[j];
    }
  }

  void mirror() {
    for (std::size_t i = 0; i < size; ++i) {
      for (std::size_t j = 0; j < i; ++j) normal[i * size + j] = normal[j * size + i];
    }
  }

  // Adds a prior whose mean is `offset` away.
  void add_prior(const double* information, const std::array<double, size>& offset) {
    for (std::size_t i = 0; i < size; ++i) {
      for (std::size_t j = 0; j < size; ++j) {
        normal[i * size + j] += information[i * size + j];
        gradient[i] += information[i * size + j] * offset[j];
      }
    }
  }
};

// The two residuals of a landmark in standard deviations, and their derivatives by the camera's twist.
struct Residuals {
  double value[2];
  Vec6 jacobian[2];

  // ray: of the landmark; sd: its standard deviations; local: point in the camera's frame.
  Residuals(const Vec3& local, const double* ray, const double* sd) {
    const double inverse_z = 1.0 / local[2];
    for (std::size_t axis = 0; axis < 2; ++axis) {
      const double seen = local[axis] * inverse_z, scale = inverse_z / sd[axis];
      value[axis] = (seen - ray[axis]) / sd[axis];
      const Vec3 by_point{axis == 0 ? scale : 0.0, axis == 1 ? scale : 0.0, -seen * scale};
      const Vec3 by_rotation = cross(by_point, local);
      for (std::size_t i = 0; i < 3; ++i) {
        jacobian[axis][i] = -by_point[i];
        jacobian[axis][3 + i] = by_rotation[i];
      }
    }
  }

  double weight(double kernel_sd) const {
    const double q = 1.0 + (value[0] * value[0] + value[1] * value[1]) / (kernel_sd * kernel_sd);
    return 1.0 / (q * q);
  }
};

Vec3 local_point(const SeenLandmarks& seen, const Motion& camera_from_world, std::size_t index) {
  const double* p = seen.points + 3 * index;
  Vec3 local = rotate(camera_from_world.rotation, {p[0], p[1], p[2]});
  for (std::size_t i = 0; i < 3; ++i) local[i] += camera_from_world.translation[i];
  local[2] = std::max(local[2], seen.nearest_m);
  return local;
}

// Normal equations of the pose alone; weights: (count), or nullptr.
NormalEquations<6> pose_equations(const SeenLandmarks& seen, const Motion& pose, double kernel_sd, double* weights) {
  NormalEquations<6> equations;
  const Motion camera_from_world = inverse(pose);
  for (std::size_t n = 0; n < seen.count; ++n) {
    const Residuals residuals(local_point(seen, camera_from_world, n), seen.rays + 2 * n, seen.sd + 2 * n);
    const double weight = residuals.weight(kernel_sd);
    if (weights != nullptr) weights[n] = weight;
    for (std::size_t axis = 0; axis < 2; ++axis) {
      equations.add(residuals.jacobian[axis], weight, residuals.value[axis]);
    }
  }
  equations.mirror();
  return equations;
}

// Normal equations of the pose and of logarithms: of the focal length and, with eight unknowns, of the aspect.
template <std::size_t size>
NormalEquations<size> lens_equations(const SeenLandmarks& seen, const Motion& pose,
                                     const std::array<double, size - 6>& logarithms, double kernel_sd) {
  NormalEquations<size> equations;
  const Motion camera_from_world = inverse(pose);
  // A ray is a pixel over the focal length, and so is its standard deviation: residuals stay in pixels. If only the
  // rays shrank, those of a long focal length would be small wherever the landmarks are.
  double shrink[2] = {std::exp(-logarithms[0]), std::exp(-logarithms[0])};
  if constexpr (size == 8) shrink[1] = std::exp(-logarithms[0] - logarithms[1]);
  for (std::size_t n = 0; n < seen.count; ++n) {
    const double ray[2] = {seen.rays[2 * n] * shrink[0], seen.rays[2 * n + 1] * shrink[1]};
    const double sd[2] = {seen.sd[2 * n] * shrink[0], seen.sd[2 * n + 1] * shrink[1]};
    const Residuals residuals(local_point(seen, camera_from_world, n), ray, sd);
    const double weight = residuals.weight(kernel_sd);
    for (std::size_t axis = 0; axis < 2; ++axis) {
      std::array<double, size> row;
      std::copy_n(residuals.jacobian[axis].begin(), 6, row.begin());
      row[6] = residuals.value[axis] + ray[axis] / sd[axis];
      if constexpr (size == 8) row[7] = axis == 1 ? row[6] : 0.0;
      equations.add(row, weight, residuals.value[axis]);
    }
  }
  equations.mirror();
  return equations;
}

// Moves a pose against the first six entries of a step.
Motion moved(const Motion& pose, const double* step) {
  return compose(pose, se3_exp({-step[0], -step[1], -step[2], -step[3], -step[4], -step[5]}));
}

// The last of the logarithms, fitted with the pose and the others.
template <std::size_t size>
LogRatio fit_lens(const SeenLandmarks& seen, const double* pose, const double* information,
                  const KernelSchedule& kernels) {
  const Motion start = motion_of(pose), from_start = inverse(start);
  Motion now = start;
  std::array<double, size - 6> logarithms{};
  LogRatio fit{0.0, 0.0};
  for (std::size_t k = 0; k < kernels.count; ++k) {
    NormalEquations<size> equations = lens_equations<size>(seen, now, logarithms, kernels.sds[k]);
    const Vec6 twist = se3_log(compose(from_start, now));
    std::array<double, size> offset;
    std::copy(twist.begin(), twist.end(), offset.begin());
    std::copy(logarithms.begin(), logarithms.end(), offset.begin() + 6);
    equations.add_prior(information, offset);
    std::array<double, size * size> normal = equations.normal;
    std::array<double, size> variance{};
    variance[size - 1] = 1.0;  // for the last column of the inverse
    solve(normal.data(), variance.data(), size);
    solve(equations.normal.data(), equations.gradient.data(), size);
    now = moved(now, equations.gradient.data());
    for (std::size_t i = 0; i < logarithms.size(); ++i) logarithms[i] -= equations.gradient[6 + i];
    fit = {logarithms.back(), std::sqrt(variance[size - 1])};
  }
  return fit;
}

}  // namespace

PoseFit fit_pose(const SeenLandmarks& seen, const double* prior, const double* information,
                 const KernelSchedule& kernels) {
  const Motion start = motion_of(prior), from_start = inverse(start);
  Motion pose = start;
  for (std::size_t k = 0; k < kernels.count; ++k) {
    NormalEquations<6> equations = pose_equations(seen, pose, kernels.sds[k], nullptr);
    equations.add_prior(information, se3_log(compose(from_start, pose)));
    solve(equations.normal.data(), equations.gradient.data(), 6);
    pose = moved(pose, equations.gradient.data());
  }
  PoseFit fit;
  fit.weights.resize(seen.count);
  const NormalEquations<6> last = pose_equations(seen, pose, kernels.sds[kernels.count - 1], fit.weights.data());
  write_pose(pose, fit.pose);
  std::copy(last.normal.begin(), last.normal.end(), fit.normal);
  std::copy(last.gradient.begin(), last.gradient.end(), fit.gradient);
  return fit;
}

std::vector<double> leverages(const SeenLandmarks& seen, const double* pose, const double* covariance,
                              const double* weights) {
  const Motion camera_from_world = inverse(motion_of(pose));
  std::vector<double> found(seen.count);
  for (std::size_t n = 0; n < seen.count; ++n) {
    const Residuals residuals(local_point(seen, camera_from_world, n), seen.rays + 2 * n, seen.sd + 2 * n);
    double variance = 0.0;
    for (const Vec6& row : residuals.jacobian) {
      for (std::size_t i = 0; i < 6; ++i) {
        for (std::size_t j = 0; j < 6; ++j) variance += row[i] * covariance[6 * i + j] * row[j];
      }
    }
    found[n] = weights[n] * variance;
  }
  return found;
}

LogRatio fit_log_focal(const SeenLandmarks& seen, const double* pose, const double* information,
                       const KernelSchedule& kernels) {
  return fit_lens<7>(seen, pose, information, kernels);
}

LogRatio fit_log_aspect(const SeenLandmarks& seen, const double* pose, const double* information,
                        const KernelSchedule& kernels) {
  return fit_lens<8>(seen, pose, information, kernels);
}

}  // namespace monoloc
