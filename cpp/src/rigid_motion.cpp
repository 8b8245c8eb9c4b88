#include "monoloc/rigid_motion.hpp"

#include <algorithm>
#include <cmath>

#include "linear_solve.hpp"

namespace monoloc {
namespace {

constexpr double kSmallAngle = 1e-4;  // below this, series replace the quotients of sine and cosine

// sin(t)/t, (1 - cos(t))/t^2 and (t - sin(t))/t^3.
struct Quotients {
  double a, b, c;
};

Quotients quotients_of(double t) {
  const double t2 = t * t;
  if (t < kSmallAngle) return {1.0 - t2 / 6.0, 0.5 - t2 / 24.0, 1.0 / 6.0 - t2 / 120.0};
  const double half = std::sin(0.5 * t);
  return {std::sin(t) / t, 2.0 * half * half / t2, (t - std::sin(t)) / (t2 * t)};
}

double norm(const Vec3& v) { return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

// I + first hat(phi) + second hat(phi)^2, row-major.
std::array<double, 9> series(const Vec3& phi, double first, double second) {
  std::array<double, 9> matrix;
  const double squared = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2];
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) matrix[3 * i + j] = second * phi[i] * phi[j];
    matrix[4 * i] += 1.0 - second * squared;
  }
  for (std::size_t i = 0; i < 3; ++i) {
    const std::size_t j = (i + 1) % 3, k = (i + 2) % 3;
    matrix[3 * j + i] += first * phi[k];
    matrix[3 * i + j] -= first * phi[k];
  }
  return matrix;
}

// Rotation vector, by the unit quaternion, which is well conditioned at every angle. The symmetric matrix 4 q q^T is
// linear in the rotation, and its column with the largest diagonal entry is never near zero (Markley 2008).
Vec3 so3_log(const std::array<double, 9>& r) {
  const double trace = r[0] + r[4] + r[8];
  const double axial[3] = {r[7] - r[5], r[2] - r[6], r[3] - r[1]};
  double outer[4][4];
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) outer[i][j] = r[3 * i + j] + r[3 * j + i] + (i == j ? 1.0 - trace : 0.0);
    outer[i][3] = outer[3][i] = axial[i];
  }
  outer[3][3] = 1.0 + trace;
  std::size_t largest = 0;
  for (std::size_t i = 1; i < 4; ++i) {
    if (outer[i][i] > outer[largest][largest]) largest = i;
  }
  const double* q = outer[largest];
  const double sign = q[3] < 0.0 ? -1.0 : 1.0;
  const double length = sign * std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  const Vec3 vector{q[0] / length, q[1] / length, q[2] / length};
  const double w = q[3] / length, sine = norm(vector);
  const double scale = sine < kSmallAngle ? 2.0 / w : 2.0 * std::atan2(sine, w) / sine;
  return {scale * vector[0], scale * vector[1], scale * vector[2]};
}

}  // namespace

Motion motion_of(const double* pose) {
  Motion motion;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) motion.rotation[3 * i + j] = pose[4 * i + j];
    motion.translation[i] = pose[4 * i + 3];
  }
  return motion;
}

void write_pose(const Motion& motion, double* pose) {
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) pose[4 * i + j] = motion.rotation[3 * i + j];
    pose[4 * i + 3] = motion.translation[i];
  }
  for (std::size_t j = 0; j < 4; ++j) pose[12 + j] = j == 3 ? 1.0 : 0.0;
}

Motion compose(const Motion& first, const Motion& second) {
  Motion both;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) {
      both.rotation[3 * i + j] = first.rotation[3 * i] * second.rotation[j] +
                                 first.rotation[3 * i + 1] * second.rotation[3 + j] +
                                 first.rotation[3 * i + 2] * second.rotation[6 + j];
    }
  }
  both.translation = rotate(first.rotation, second.translation);
  for (std::size_t i = 0; i < 3; ++i) both.translation[i] += first.translation[i];
  return both;
}

Motion inverse(const Motion& motion) {
  const auto& r = motion.rotation;
  Motion back{{r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8]}, {}};
  back.translation = rotate(back.rotation, motion.translation);
  for (double& value : back.translation) value = -value;
  return back;
}

Motion se3_exp(const Vec6& twist) {
  const Vec3 rho{twist[0], twist[1], twist[2]}, phi{twist[3], twist[4], twist[5]};
  const Quotients q = quotients_of(norm(phi));
  return {series(phi, q.a, q.b), rotate(series(phi, q.b, q.c), rho)};
}

Vec6 se3_log(const Motion& motion) {
  const Vec3 phi = so3_log(motion.rotation);
  const Quotients q = quotients_of(norm(phi));
  std::array<double, 9> left_jacobian = series(phi, q.b, q.c);
  Vec3 rho = motion.translation;
  solve(left_jacobian.data(), rho.data(), 3);
  return {rho[0], rho[1], rho[2], phi[0], phi[1], phi[2]};
}

void se3_exp(const double* twists, std::size_t count, double* poses) {
  for (std::size_t i = 0; i < count; ++i) {
    const double* t = twists + 6 * i;
    write_pose(se3_exp(Vec6{t[0], t[1], t[2], t[3], t[4], t[5]}), poses + 16 * i);
  }
}

void se3_log(const double* poses, std::size_t count, double* twists) {
  for (std::size_t i = 0; i < count; ++i) {
    const Vec6 twist = se3_log(motion_of(poses + 16 * i));
    std::copy(twist.begin(), twist.end(), twists + 6 * i);
  }
}

void pose_distances(const double* pose, const double* others, std::size_t count, double turn_worth, double* out) {
  const Motion here = motion_of(pose), back = inverse(here);
  for (std::size_t i = 0; i < count; ++i) {
    const Motion there = motion_of(others + 16 * i);
    const std::array<double, 9> turn = compose(back, there).rotation;
    const double sine = 0.5 * norm({turn[7] - turn[5], turn[2] - turn[6], turn[3] - turn[1]});
    const double cosine = 0.5 * (turn[0] + turn[4] + turn[8] - 1.0);
    const Vec3& a = here.translation;
    const Vec3& b = there.translation;
    out[i] = norm({b[0] - a[0], b[1] - a[1], b[2] - a[2]}) + turn_worth * std::atan2(sine, cosine);
  }
}

}  // namespace monoloc
