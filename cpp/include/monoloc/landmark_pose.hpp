// Pose of a camera, and its focal length, from the landmarks that it sees, of which some are wrong matches.
#pragma once

#include <cstddef>
#include <vector>

namespace monoloc {

// Landmarks and where a camera sees them.
struct SeenLandmarks {
  const double* points;  // (count, 3) world frame
  const double* rays;    // (count, 2) image coordinates at z = 1
  const double* sd;      // (count, 2) their standard deviations
  std::size_t count;
  double nearest_m;      // in the camera's frame, depths count as this at least
};

// Standard deviations at which a landmark's Geman-McClure weight is a quarter, one of each Gauss-Newton step.
struct KernelSchedule {
  const double* sds;
  std::size_t count;  // at least 1
};

// A pose, and the normal equations there, of the landmarks alone, with the last kernel.
struct PoseFit {
  double pose[16];      // T_world_camera, row-major
  double normal[36];    // of its twist (rho, phi)
  double gradient[6];
  std::vector<double> weights;  // of the landmarks
};

// From a prior pose (4, 4) with an information matrix (6, 6), which takes part in all steps.
// All is NaN if an argument is. Throws std::domain_error if a step's normal matrix is singular.
PoseFit fit_pose(const SeenLandmarks& seen, const double* prior, const double* information,
                 const KernelSchedule& kernels);

// By how much each landmark determines the pose that is fitted to all (the trace of its part of the hat matrix): between
// 0 and 2, since it has two coordinates, and 6 in all.
// pose: (4, 4); covariance: (6, 6) of its twist by all landmarks; weights: (count), as of the fit.
std::vector<double> leverages(const SeenLandmarks& seen, const double* pose, const double* covariance,
                              const double* weights);

// Logarithm of a true over a stated value, and its standard deviation.
struct LogRatio {
  double value, sd;
};

// Of the focal length, with the pose, from a pose (4, 4) and a log-focal of 0 as a prior with an information matrix
// (7, 7). NaN if an argument is. Throws std::domain_error if a step's normal matrix is singular.
LogRatio fit_log_focal(const SeenLandmarks& seen, const double* pose, const double* information,
                       const KernelSchedule& kernels);

// Of the aspect: the focal length along y over that along x. With pose and focal length, as above; information (8, 8).
LogRatio fit_log_aspect(const SeenLandmarks& seen, const double* pose, const double* information,
                        const KernelSchedule& kernels);

}  // namespace monoloc
