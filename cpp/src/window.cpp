#include "monoloc/window.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "linear_solve.hpp"
#include "monoloc/kernels.hpp"
#include "padded.hpp"
#include "monoloc/rigid_motion.hpp"

namespace monoloc {
namespace {

constexpr double kPoseDamping = 1e-6;

// The last multiple of kPadding up to a number.
std::size_t rounded_down(std::size_t count) { return count / kPadding * kPadding; }

// What the kernels read and write, and the Gauss-Newton steps between.
class Adjustment {
 public:
  explicit Adjustment(const Observations& all)
      : corners_(all.corners),
        frames_(all.frames),
        unknowns_(6 * (all.frames - 1)),
        stride_(padded(all.corners)),
        row_stride_(padded(unknowns_ + 1)),
        scales_{1.0 / all.ray_sd, 1.0 / all.log_depth_sd},
        observations_(6 * frames_ * stride_, 0.0),
        first_unknown_(stride_ / kPadding, rounded_down(unknowns_)),
        cameras_(12 * frames_),
        points_(3 * stride_, 0.0),
        poses_(frames_ * kPoseSums * kPadding),
        information_(6 * stride_),
        whiten_(6 * stride_),
        rows_(3 * stride_ * row_stride_, 0.0),
        scratch_(12 * frames_ * kPadding),
        gram_(row_stride_ * row_stride_) {
    for (std::size_t n = 0; n < corners_; ++n) {
      for (std::size_t w = 0; w < frames_; ++w) {
        const std::size_t at = n * frames_ + w;
        const double values[3] = {all.rays[2 * at], all.rays[2 * at + 1], all.log_depth[at]};
        for (std::size_t i = 0; i < 3; ++i) {
          if (!std::isfinite(values[i])) continue;
          observations_[(6 * w + i) * stride_ + n] = values[i];
          observations_[(6 * w + 3 + i) * stride_ + n] = 1.0;
          std::size_t& first = first_unknown_[n / kPadding];
          if (w > 0) first = std::min(first, rounded_down(6 * (w - 1)));
        }
      }
    }
  }

  void step(double* poses, double* points) {
    linearise(poses, points);
    const std::vector<double> twists = solution();
    for (std::size_t w = 1; w < frames_; ++w) {
      Vec6 twist;
      for (std::size_t i = 0; i < 6; ++i) twist[i] = -twists[6 * (w - 1) + i];
      write_pose(compose(motion_of(poses + 16 * w), se3_exp(twist)), poses + 16 * w);
    }
    for (std::size_t n = 0; n < corners_; ++n) {
      Vec3 right;
      for (std::size_t c = 0; c < 3; ++c) {
        const double* row = rows_.data() + (3 * n + c) * row_stride_;
        right[c] = row[unknowns_];
        for (std::size_t i = 0; i < unknowns_; ++i) right[c] -= row[i] * twists[i];
      }
      const double *l = whiten_.data() + n, *r = right.data();
      points[3 * n] -= l[0] * r[0] + l[stride_] * r[1] + l[3 * stride_] * r[2];
      points[3 * n + 1] -= l[2 * stride_] * r[1] + l[4 * stride_] * r[2];
      points[3 * n + 2] -= l[5 * stride_] * r[2];
    }
  }

  // Of the last linearisation.
  void write_information(double* information) const {
    constexpr std::size_t kEntries[9] = {0, 1, 2, 1, 3, 4, 2, 4, 5};
    for (std::size_t n = 0; n < corners_; ++n) {
      for (std::size_t i = 0; i < 9; ++i) information[9 * n + i] = information_[kEntries[i] * stride_ + n];
    }
  }

 private:
  void linearise(const double* poses, const double* points) {
    for (std::size_t w = 0; w < frames_; ++w) {
      const Motion camera = inverse(motion_of(poses + 16 * w));
      std::copy(camera.rotation.begin(), camera.rotation.end(), cameras_.begin() + 12 * w);
      std::copy(camera.translation.begin(), camera.translation.end(), cameras_.begin() + 12 * w + 9);
    }
    for (std::size_t n = 0; n < corners_; ++n) {
      for (std::size_t i = 0; i < 3; ++i) points_[i * stride_ + n] = points[3 * n + i];
    }
    std::fill(poses_.begin(), poses_.end(), 0.0);
    std::fill(gram_.begin(), gram_.end(), 0.0);
    const WindowView view{cameras_.data(), observations_.data(), points_.data(), frames_, stride_,
                          scales_[0],      scales_[1]};
    const WindowSums sums{poses_.data(), information_.data(), whiten_.data(), rows_.data(), row_stride_,
                          scratch_.data()};
    for (std::size_t n = 0; n < stride_; n += kPadding) {
      kernels().linearise_window(view, n, sums);
      const std::size_t first = first_unknown_[n / kPadding];
      kernels().add_gram(rows_.data() + 3 * n * row_stride_ + first, 3 * kPadding, unknowns_ + 1 - first, row_stride_,
                         gram_.data() + first * (row_stride_ + 1));
    }
  }

  // Sum of a keyframe's kPoseSums.
  double pose_sum(std::size_t frame, std::size_t index) const {
    const double* partial = poses_.data() + (frame * kPoseSums + index) * kPadding;
    double sum = 0.0;
    for (std::size_t lane = 0; lane < kPadding; ++lane) sum += partial[lane];
    return sum;
  }

  // The twists of all keyframes but the first that solve the normal equations, with the opposite sign.
  std::vector<double> solution() const {
    std::vector<double> normal(unknowns_ * unknowns_), right(unknowns_);
    for (std::size_t i = 0; i < unknowns_; ++i) {
      for (std::size_t j = i; j < unknowns_; ++j) {
        normal[i * unknowns_ + j] = normal[j * unknowns_ + i] = -gram_[i * row_stride_ + j];
      }
      right[i] = pose_sum(1 + i / 6, 27 + i % 6) - gram_[i * row_stride_ + unknowns_];
    }
    for (std::size_t w = 1; w < frames_; ++w) add_pose_block(w, normal.data() + 6 * (w - 1) * (unknowns_ + 1));
    solve(normal.data(), right.data(), unknowns_);
    return right;
  }

  void add_pose_block(std::size_t frame, double* block) const {
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t j = 0; j < 3; ++j) {
        const double damping = i == j ? 1.0 + kWindowDamping : 1.0, added = i == j ? kPoseDamping : 0.0;
        const double mixed = pose_sum(frame, 9 + 3 * i + j);
        block[i * unknowns_ + j] += damping * pose_sum(frame, 3 * i + j) + added;
        block[i * unknowns_ + 3 + j] += mixed;
        block[(3 + j) * unknowns_ + i] += mixed;
        block[(3 + i) * unknowns_ + 3 + j] += damping * pose_sum(frame, 18 + 3 * i + j) + added;
      }
    }
  }

  std::size_t corners_, frames_, unknowns_, stride_, row_stride_;
  std::array<double, 2> scales_;
  std::vector<double> observations_;
  std::vector<std::size_t> first_unknown_;  // of a batch of kPadding corners, rounded down; zeros are before it
  std::vector<double> cameras_, points_, poses_, information_, whiten_, rows_, scratch_;
  std::vector<double> gram_;  // products of the rows' columns
};

}  // namespace

void adjust_window(const Observations& observations, std::size_t iterations, double* poses, double* points,
                   double* information) {
  if (observations.frames == 0 || iterations == 0) return;
  Adjustment adjustment(observations);
  for (std::size_t iteration = 0; iteration < iterations; ++iteration) adjustment.step(poses, points);
  adjustment.write_information(information);
}

}  // namespace monoloc
