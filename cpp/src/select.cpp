#include "select.hpp"

#include <algorithm>
#include <cmath>

#include "padded.hpp"

namespace monoloc {
namespace {

// A voxel is sampled on a lattice that includes its faces. The spacing is fine enough to detect every component.
constexpr double kSamplesPerSigma = 0.4;  // of the thinnest component
constexpr std::size_t kFewestPerAxis = 5, kMostPerAxis = 17;
constexpr double kHalfLog2E = 0.72134752044448170;  // squared scale of Component::whiten

std::size_t samples_per_axis(const std::vector<Component>& mixture, double voxel_m) {
  double steepest = 0.0;  // Frobenius norm of L^-1: at least 1 / (smallest standard deviation), at most sqrt(3) of it
  for (const Component& c : mixture) {
    double squared = 0.0;
    for (const double w : c.whiten) squared += w * w;
    steepest = std::max(steepest, std::sqrt(squared / kHalfLog2E));
  }
  const double wanted = std::min(std::ceil(voxel_m * steepest * kSamplesPerSigma) + 1.0, 1e6);
  return std::clamp(static_cast<std::size_t>(wanted), kFewestPerAxis, kMostPerAxis);
}

}  // namespace

Selector::Selector(const std::vector<Component>& mixture, const IndexSettings& settings)
    : mixture_(mixture), settings_(settings) {
  const std::size_t per_axis = samples_per_axis(mixture, settings.voxel_m);
  const std::size_t samples = per_axis * per_axis * per_axis;
  stride_ = padded(samples);
  offsets_.resize(3 * stride_);
  const double step = settings.voxel_m / static_cast<double>(per_axis - 1);
  for (std::size_t i = 0; i < stride_; ++i) {
    const std::size_t s = std::min(i, samples - 1);
    const std::size_t along[3] = {s % per_axis, s / per_axis % per_axis, s / (per_axis * per_axis)};
    for (int axis = 0; axis < 3; ++axis) {
      offsets_[axis * stride_ + i] = static_cast<float>(step * static_cast<double>(along[axis]));
    }
  }
}

void Selector::select(List& candidates, const double* corner) {
  if (candidates.empty()) return;
  const Kernels& run = kernels();
  if (densities_.size() < candidates.size() * stride_) densities_.resize(candidates.size() * stride_);
  total_.assign(stride_, static_cast<float>(settings_.floor_density));
  for (std::size_t c = 0; c < candidates.size(); ++c) {
    run.component_density(mixture_[candidates[c]], corner, offsets_.data(), stride_, densities_.data() + c * stride_,
                          total_.data());
  }
  importance_.clear();
  for (std::size_t c = 0; c < candidates.size(); ++c) {
    importance_.emplace_back(run.divide(densities_.data() + c * stride_, total_.data(), stride_), c);
  }
  std::sort(importance_.begin(), importance_.end());
  dropped_.assign(stride_, 0.0f);
  kept_.clear();
  for (const auto& [most, c] : importance_) {
    const float* share = densities_.data() + c * stride_;
    if (kept_.empty() && run.largest_sum(dropped_.data(), share, stride_) <= settings_.tolerance) {
      for (std::size_t s = 0; s < stride_; ++s) dropped_[s] += share[s];
    } else {
      kept_.push_back(candidates[c]);
    }
  }
  std::sort(kept_.begin(), kept_.end());
  candidates.assign(kept_.begin(), kept_.end());
}

}  // namespace monoloc
