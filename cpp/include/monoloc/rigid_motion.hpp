// Rigid motions in SE(3), as in monoloc.geometry: a twist is (rho, phi).
#pragma once

#include <array>
#include <cstddef>

namespace monoloc {

using Vec3 = std::array<double, 3>;
using Vec6 = std::array<double, 6>;

// Maps x to rotation x + translation.
struct Motion {
  std::array<double, 9> rotation;  // row-major
  Vec3 translation;
};

Motion motion_of(const double* pose);  // of a matrix (4, 4)
void write_pose(const Motion& motion, double* pose);

Motion compose(const Motion& first, const Motion& second);  // first second
Motion inverse(const Motion& motion);

Motion se3_exp(const Vec6& twist);
Vec6 se3_log(const Motion& motion);

// Of `count` at once: twists (count, 6) and poses (count, 4, 4), row-major.
void se3_exp(const double* twists, std::size_t count, double* poses);
void se3_log(const double* poses, std::size_t count, double* twists);

// From a pose (4, 4) to others (count, 4, 4): the shift's length plus `turn_worth` times the angle of the turn.
void pose_distances(const double* pose, const double* others, std::size_t count, double turn_worth, double* out);

inline Vec3 cross(const Vec3& a, const Vec3& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

inline Vec3 rotate(const std::array<double, 9>& r, const Vec3& x) {
  return {r[0] * x[0] + r[1] * x[1] + r[2] * x[2], r[3] * x[0] + r[4] * x[1] + r[5] * x[2],
          r[6] * x[0] + r[7] * x[1] + r[8] * x[2]};
}

}  // namespace monoloc
