#include "monoloc/landmark_consensus.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "monoloc/rigid_motion.hpp"

namespace monoloc {
namespace {

constexpr std::size_t kTriple = 3;
constexpr std::size_t kMostPoses = 4;  // of a triple
constexpr std::size_t kFitSteps = 2, kMostFits = 4;  // of a pose to the landmarks that agree with it
constexpr double kNegligible = 1e-12;  // beside squares of a quartic's roots; rounding leaves few digits of less

double dot(const Vec3& a, const Vec3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Vec3 scaled(const Vec3& a, double factor) { return {factor * a[0], factor * a[1], factor * a[2]}; }
Vec3 minus(const Vec3& a, const Vec3& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
Vec3 unit(const Vec3& a) { return scaled(a, 1.0 / std::sqrt(dot(a, a))); }

// The same sequence as NumPy's twin (splitmix64, Steele et al. 2014).
class Random {
 public:
  std::size_t below(std::size_t count) {
    std::uint64_t z = (state_ += 0x9E3779B97F4A7C15u);
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return static_cast<std::size_t>((z ^ (z >> 31)) % count);
  }

  std::array<std::size_t, kTriple> triple(std::size_t count) {
    std::array<std::size_t, kTriple> drawn{below(count), below(count), below(count)};
    while (drawn[1] == drawn[0]) drawn[1] = below(count);
    while (drawn[2] == drawn[0] || drawn[2] == drawn[1]) drawn[2] = below(count);
    return drawn;
  }

 private:
  std::uint64_t state_ = 0;
};

// Largest real root of m^3 + a m^2 + b m + c.
double largest_root(double a, double b, double c) {
  const double third = a / 3.0, p = b / 3.0 - third * third, q = third * third * third - 0.5 * (third * b - c);
  const double under = q * q + p * p * p;
  if (under >= 0.0) {
    const double root = std::sqrt(under);
    return std::cbrt(-q + root) + std::cbrt(-q - root) - third;
  }
  const double radius = std::sqrt(-p);
  const double cosine = std::clamp(-q / (radius * radius * radius), -1.0, 1.0);
  return 2.0 * radius * std::cos(std::acos(cosine) / 3.0) - third;
}

// Real roots of y^4 + p y^2 + r, by the quadratic in y^2. Returns their number.
std::size_t biquadratic_roots(double p, double r, double* roots) {
  const double larger = -0.5 * p + std::copysign(std::sqrt(0.25 * p * p - r), -p);
  std::size_t count = 0;
  for (const double square : {larger, r / larger}) {  // so, nothing cancels in the smaller
    if (!(square >= 0.0)) continue;
    for (const double side : {1.0, -1.0}) roots[count++] = side * std::sqrt(square);
  }
  return count;
}

// Axes of two directions: the first, and the one across both.
std::array<double, 9> axes(const Vec3& first, const Vec3& second) {
  const Vec3 x = unit(first), z = unit(cross(first, second)), y = cross(z, x);
  return {x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]};
}

// Motion that takes three points there to three points here.
Motion aligned(const std::array<Vec3, kTriple>& there, const std::array<Vec3, kTriple>& here) {
  const auto from = axes(minus(there[1], there[0]), minus(there[2], there[0]));
  const auto to = axes(minus(here[1], here[0]), minus(here[2], here[0]));
  Motion motion;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) {
      motion.rotation[3 * i + j] =
          to[3 * i] * from[3 * j] + to[3 * i + 1] * from[3 * j + 1] + to[3 * i + 2] * from[3 * j + 2];
    }
  }
  motion.translation = minus(here[0], rotate(motion.rotation, there[0]));
  return motion;
}

// Camera from world, for each pose from which three points are seen in three directions (unit vectors).
std::size_t poses_of(const std::array<Vec3, kTriple>& points, const std::array<Vec3, kTriple>& directions,
                     std::array<Motion, kMostPoses>& poses) {
  const Vec3 side_a = minus(points[1], points[2]), side_b = minus(points[0], points[2]),
             side_c = minus(points[0], points[1]);
  const double b2 = dot(side_b, side_b), a2 = dot(side_a, side_a) / b2, c2 = dot(side_c, side_c) / b2;
  const double cos_a = dot(directions[1], directions[2]), cos_b = dot(directions[0], directions[2]),
               cos_c = dot(directions[0], directions[1]);
  const double k = a2 - c2, sum = a2 + c2;
  // In v, the third distance over the first.
  const double quartic[5] = {
      (1.0 + k) * (1.0 + k) - 4.0 * a2 * cos_c * cos_c,
      4.0 * (-k * (1.0 + k) * cos_b + 2.0 * a2 * cos_c * cos_c * cos_b - (1.0 - sum) * cos_a * cos_c),
      2.0 * (k * k - 1.0 + 2.0 * k * k * cos_b * cos_b + 2.0 * (1.0 - c2) * cos_a * cos_a -
             4.0 * sum * cos_a * cos_b * cos_c + 2.0 * (1.0 - a2) * cos_c * cos_c),
      4.0 * (k * (1.0 - k) * cos_b - (1.0 - sum) * cos_a * cos_c + 2.0 * c2 * cos_a * cos_a * cos_b),
      (k - 1.0) * (k - 1.0) - 4.0 * c2 * cos_a * cos_a};
  double roots[kMostPoses];
  const std::size_t count = real_roots(quartic, roots);
  std::size_t found = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const double v = roots[i];
    const double u = ((k - 1.0) * v * v - 2.0 * k * cos_b * v + 1.0 + k) / (2.0 * (cos_c - v * cos_a));
    const double first = std::sqrt(b2 / (1.0 + v * v - 2.0 * v * cos_b));
    if (!(v > 0.0 && u > 0.0 && std::isfinite(u) && std::isfinite(first))) continue;
    poses[found++] = aligned(
        points, {scaled(directions[0], first), scaled(directions[1], u * first), scaled(directions[2], v * first)});
  }
  return found;
}

bool agrees(const SeenLandmarks& seen, const Motion& camera_from_world, double most_sd, std::size_t index) {
  const double *p = seen.points + 3 * index, *ray = seen.rays + 2 * index, *sd = seen.sd + 2 * index;
  const Vec3 turned = rotate(camera_from_world.rotation, {p[0], p[1], p[2]});
  const Vec3& shift = camera_from_world.translation;
  const double z = turned[2] + shift[2];
  const double x = (turned[0] + shift[0] - ray[0] * z) / sd[0], y = (turned[1] + shift[1] - ray[1] * z) / sd[1];
  return (z > seen.nearest_m) & (x * x + y * y < most_sd * most_sd * z * z);
}

std::vector<std::uint32_t> agreeing_with(const SeenLandmarks& seen, const Motion& camera_from_world, double most_sd) {
  std::vector<std::uint32_t> agreeing;
  for (std::size_t n = 0; n < seen.count; ++n) {
    if (agrees(seen, camera_from_world, most_sd, n)) agreeing.push_back(static_cast<std::uint32_t>(n));
  }
  return agreeing;
}

// Pose fitted to some landmarks from a start, camera from world.
Motion fitted(const SeenLandmarks& seen, const std::vector<std::uint32_t>& chosen, const Motion& start, double most_sd) {
  std::vector<double> points, rays, sd;
  for (const std::uint32_t n : chosen) {
    points.insert(points.end(), seen.points + 3 * n, seen.points + 3 * n + 3);
    rays.insert(rays.end(), seen.rays + 2 * n, seen.rays + 2 * n + 2);
    sd.insert(sd.end(), seen.sd + 2 * n, seen.sd + 2 * n + 2);
  }
  double prior[16], information[36] = {};
  write_pose(inverse(start), prior);
  for (std::size_t i = 0; i < 6; ++i) information[7 * i] = 1.0;  // m^-2, rad^-2: a few landmarks say far more
  const double kernels[kFitSteps] = {most_sd, most_sd};
  const SeenLandmarks those{points.data(), rays.data(), sd.data(), chosen.size(), seen.nearest_m};
  return inverse(motion_of(fit_pose(those, prior, information, {kernels, kFitSteps}).pose));
}

// Number of triples among which one of agreeing landmarks is with probability `confidence`.
double triples_for(double agreeing_share, double confidence) {
  const double all_agree = agreeing_share * agreeing_share * agreeing_share;
  return all_agree >= 1.0 ? 0.0 : std::log1p(-confidence) / std::log1p(-all_agree);
}

}  // namespace

std::size_t real_roots(const double* coefficients, double* roots) {
  // Ferrari: y^4 + p y^2 + q y + r with x = y - shift, as a product of two quadratics.
  const double a = coefficients[3] / coefficients[4], b = coefficients[2] / coefficients[4],
               c = coefficients[1] / coefficients[4], d = coefficients[0] / coefficients[4];
  const double shift = a / 4.0, shift2 = shift * shift;
  const double p = b - 6.0 * shift2, q = c - 2.0 * b * shift + 8.0 * shift2 * shift,
               r = d - c * shift + b * shift2 - 3.0 * shift2 * shift2;
  const double m = largest_root(p, p * p / 4.0 - r, -q * q / 8.0);
  if (!std::isfinite(m)) return 0;  // nor is a coefficient
  std::size_t count = 0;
  if (m > kNegligible * (std::abs(p) + std::sqrt(std::abs(r)))) {
    const double middle = std::sqrt(2.0 * m);
    for (const double sign : {1.0, -1.0}) {
      const double under = -2.0 * (p + m + sign * q / middle);
      if (!(under >= 0.0)) continue;
      for (const double side : {1.0, -1.0}) roots[count++] = 0.5 * (sign * middle + side * std::sqrt(under)) - shift;
    }
  } else {  // q is negligible, and q / middle would be mostly rounding
    count = biquadratic_roots(p, r, roots);
    for (std::size_t i = 0; i < count; ++i) roots[i] -= shift;
  }
  // Two steps of Newton's method against rounding, and for a q that was neglected.
  for (std::size_t i = 0; i < count; ++i) {
    for (int step = 0; step < 2; ++step) {
      const double x = roots[i], slope = ((4.0 * x + 3.0 * a) * x + 2.0 * b) * x + c;
      const double moved = x - ((((x + a) * x + b) * x + c) * x + d) / slope;
      if (std::isfinite(moved)) roots[i] = moved;
    }
  }
  std::sort(roots, roots + count);
  return count;
}

Consensus find_consensus(const SeenLandmarks& seen, double most_sd, std::size_t most_triples, double confidence) {
  Consensus best{};
  if (seen.count < kTriple) return best;
  std::vector<Vec3> directions(seen.count);
  for (std::size_t n = 0; n < seen.count; ++n) directions[n] = unit({seen.rays[2 * n], seen.rays[2 * n + 1], 1.0});
  Random random;
  Motion best_pose{};
  auto wanted = static_cast<double>(most_triples);
  for (std::size_t drawn = 0; static_cast<double>(drawn) < wanted; ++drawn) {
    std::array<Vec3, kTriple> points, towards;
    const auto triple = random.triple(seen.count);
    for (std::size_t i = 0; i < kTriple; ++i) {
      const double* p = seen.points + 3 * triple[i];
      points[i] = {p[0], p[1], p[2]};
      towards[i] = directions[triple[i]];
    }
    std::array<Motion, kMostPoses> poses;
    const std::size_t count = poses_of(points, towards, poses);
    for (std::size_t i = 0; i < count; ++i) {
      std::vector<std::uint32_t> agreeing = agreeing_with(seen, poses[i], most_sd);
      if (agreeing.size() <= best.agreeing.size()) continue;
      // Three noisy landmarks seldom lead to a pose that all right ones agree with: it is fitted to those that do.
      Motion pose = poses[i];
      for (std::size_t fit = 0; agreeing.size() > best.agreeing.size(); ++fit) {
        best_pose = pose;
        best.agreeing = agreeing;
        if (fit == kMostFits || agreeing.size() < kTriple) break;
        pose = fitted(seen, agreeing, pose, most_sd);
        agreeing = agreeing_with(seen, pose, most_sd);
      }
      const double share = static_cast<double>(best.agreeing.size()) / static_cast<double>(seen.count);
      wanted = std::min(wanted, triples_for(share, confidence));
    }
  }
  if (best.agreeing.size() < kTriple) return Consensus{};
  write_pose(inverse(best_pose), best.pose);
  return best;
}

}  // namespace monoloc
