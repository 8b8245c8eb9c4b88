// Selection of the components that matter in a voxel.
#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "monoloc/index.hpp"

namespace monoloc {

using List = std::vector<std::uint32_t>;  // components, ascending

// Selects the components of one voxel. Dropping a set D of components causes the relative error
// sum_D p_k(s) / (sum_all p_k(s) + floor) at a sample s. Components are dropped, least important first, as long as
// this error is within the tolerance at all samples.
class Selector {
 public:
  Selector(const std::vector<Component>& mixture, const IndexSettings& settings);

  // Replaces candidates by the selected ones, ascending; corner: the voxel's lower corner in the mixture's frame.
  void select(List& candidates, const double* corner);

 private:
  const std::vector<Component>& mixture_;
  const IndexSettings& settings_;
  std::size_t stride_;
  std::vector<float> offsets_, densities_, total_, dropped_;
  std::vector<std::pair<float, std::size_t>> importance_;
  List kept_;
};

}  // namespace monoloc
