#include "monoloc/mixture.hpp"

#include <cmath>
#include <stdexcept>
#include <string>

#include "padded.hpp"

namespace monoloc {
namespace {

constexpr double kLog2E = 1.4426950408889634074;
constexpr double kLn2 = 0.69314718055994530942;
constexpr double kLog2TwoPi = 2.6514961294723187980;
constexpr double kNoCentre[3] = {0.0, 0.0, 0.0};

}  // namespace

std::vector<Component> make_components(const double* weights, const double* means, const double* covariances,
                                       std::size_t count) {
  std::vector<Component> components(count);
  const double scale = std::sqrt(0.5 * kLog2E);
  for (std::size_t k = 0; k < count; ++k) {
    const double* s = covariances + 9 * k;
    // Cholesky: covariance = L L^T; then L^-1 by forward substitution.
    const double l00 = std::sqrt(s[0]);
    const double l10 = s[3] / l00, l20 = s[6] / l00;
    const double l11 = std::sqrt(s[4] - l10 * l10);
    const double l21 = (s[7] - l20 * l10) / l11;
    const double l22 = std::sqrt(s[8] - l20 * l20 - l21 * l21);
    const double determinant_root = l00 * l11 * l22;
    if (!(determinant_root > 0.0) || !std::isfinite(determinant_root)) {
      throw std::invalid_argument("covariance " + std::to_string(k) + " is not positive definite");
    }
    Component& c = components[k];
    const double w00 = 1.0 / l00, w11 = 1.0 / l11, w22 = 1.0 / l22;
    const double w10 = -l10 * w00 * w11;
    const double w21 = -l21 * w11 * w22;
    const double w20 = -(l20 * w00 + l21 * w10) * w22;
    const double whiten[6] = {w00, w10, w11, w20, w21, w22};
    for (int i = 0; i < 6; ++i) c.whiten[i] = scale * whiten[i];
    for (int i = 0; i < 3; ++i) c.mean[i] = means[3 * k + i];
    // Finite for a component of weight zero, because infinities would cause NaN.
    const double log2_weight = weights[k] > 0.0 ? std::log2(weights[k]) : -1e300;
    c.log2_peak = log2_weight - 1.5 * kLog2TwoPi - std::log2(determinant_root);
  }
  return components;
}

void log_density(const std::vector<Component>& mixture, const double* points, std::size_t count, double* out) {
  if (count == 0) return;
  const std::size_t stride = padded(count);
  const std::vector<double> rows = padded_rows<double>(points, count, kNoCentre);
  std::vector<double> scratch(mixture.size() * kPadding), result(stride);
  kernels().log_density(mixture.data(), mixture.size(), rows.data(), stride, scratch.data(), result.data());
  for (std::size_t i = 0; i < count; ++i) out[i] = result[i];
}

Expectation expectation(const std::vector<Component>& mixture, const double* points, std::size_t count) {
  const std::size_t components = mixture.size();
  Expectation e;
  e.mass.assign(components, 0.0);
  e.first.assign(3 * components, 0.0);
  e.second.assign(6 * components, 0.0);
  if (count == 0) return e;

  const std::size_t stride = padded(count);
  const std::vector<double> rows = padded_rows<double>(points, count, kNoCentre);
  std::vector<double> valid(stride, 0.0), scratch(components * kPadding), sums(components * 10 * kPadding, 0.0);
  std::vector<double> log2_largest(stride), relative_sum(stride);
  std::vector<std::uint32_t> active(components);
  for (std::size_t i = 0; i < count; ++i) valid[i] = 1.0;
  kernels().expectation(mixture.data(), components, rows.data(), valid.data(), stride, scratch.data(), active.data(),
                        sums.data(), log2_largest.data(), relative_sum.data());

  for (std::size_t k = 0; k < components; ++k) {
    double total[10] = {};
    for (int s = 0; s < 10; ++s) {
      for (std::size_t lane = 0; lane < kPadding; ++lane) total[s] += sums[(k * 10 + s) * kPadding + lane];
    }
    e.mass[k] = total[0];
    for (int i = 0; i < 3; ++i) e.first[3 * k + i] = total[1 + i];
    for (int i = 0; i < 6; ++i) e.second[6 * k + i] = total[4 + i];
  }
  for (std::size_t i = 0; i < count; ++i) e.log_likelihood += kLn2 * log2_largest[i] + std::log(relative_sum[i]);
  return e;
}

}  // namespace monoloc
