// What all bindings share: arrays of the caller's memory, and checks that they agree.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>

namespace nb = nanobind;

template <class T, class Shape>
using Array = nb::ndarray<const T, Shape, nb::c_contig, nb::device::cpu>;

inline void require(bool agrees, const char* what) {
  if (!agrees) throw nb::value_error(what);
}

template <class First, class Second>
void require_same_shape(const First& first, const Second& second, const char* what) {
  for (std::size_t axis = 0; axis < first.ndim(); ++axis) require(first.shape(axis) == second.shape(axis), what);
}

// Max-pooling of images, for the training of networks.
void define_pooling(nb::module_& m);
