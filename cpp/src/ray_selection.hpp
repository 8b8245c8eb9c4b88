// Selection of the components that matter along each ray of a scan.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "monoloc/kernels.hpp"

namespace monoloc {

// Some of a mixture's components, in the layout and precision of the kernels.
struct Rows {
  std::vector<float> whiten, means, log2_peak;

  RayView view() const { return {whiten.data(), means.data(), log2_peak.data(), log2_peak.size()}; }
};

// Components that matter along each ray; those of point p are from first[p] up to first[p + 1].
struct Candidates {
  std::vector<std::uint32_t> components;
  std::vector<std::size_t> first;
};

// Order of scan points (P, 3) by which neighbours follow each other, tile by tile of the image.
std::vector<std::size_t> by_tile(const float* scan, std::size_t points);

// whiten * (mean - o) of the components for `stride` particles, which are 13 rows (rotation, scale, centre).
std::vector<float> offsets_of(const RayView& view, const std::vector<float>& particles, std::size_t stride);

// Selection at kRayBatch particles, among all components. scan: rows x / z, y / z.
Candidates candidates_of(const RayView& view, const std::vector<float>& particles, const std::vector<float>& offsets,
                         const std::vector<float>& scan, std::size_t points);

// Selection at `stride` particles that are close together, and that many others resemble. Rows that no ray needs are
// removed, and the candidates are numbered as the rows that remain. scan: in the order of by_tile.
Candidates shared_candidates(Rows& rows, const std::vector<float>& particles, std::size_t stride,
                             const std::vector<float>& scan, std::size_t points);

}  // namespace monoloc
