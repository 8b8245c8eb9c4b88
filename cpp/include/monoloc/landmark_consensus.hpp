// Pose of a camera that most of its matched landmarks agree with, without a prior: RANSAC over triples.
// Sources: Fischler & Bolles 1981; Chum et al. 2003 (fits to what agrees); Grunert's equation of a triple as in
// Haralick et al. 1994.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "monoloc/landmark_pose.hpp"

namespace monoloc {

struct Consensus {
  double pose[16];                      // T_world_camera, row-major
  std::vector<std::uint32_t> agreeing;  // indices of the landmarks that agree with it, in order; none without a pose
};

// Landmarks agree within `most_sd` standard deviations. Triples are drawn up to `most_triples` times, or until one of
// agreeing landmarks was drawn with probability `confidence`. All poses are tried that a triple allows. The same input
// gives the same result.
Consensus find_consensus(const SeenLandmarks& seen, double most_sd, std::size_t most_triples, double confidence);

// Real roots of a quartic, ascending, given its coefficients from the constant to the fourth power. Returns their
// number.
std::size_t real_roots(const double* coefficients, double* roots);

}  // namespace monoloc
