// Max-pooling of images: a kernel of the training, which writes into arrays of the caller.
#include <cstdint>

#include "arrays.hpp"
#include "monoloc/pooling.hpp"

using namespace nb::literals;

namespace {

template <class T>
using Images = Array<T, nb::shape<-1, -1, -1, -1>>;
template <class T>
using WritableImages = nb::ndarray<T, nb::shape<-1, -1, -1, -1>, nb::c_contig, nb::device::cpu>;
using StageWeights = Array<float, nb::shape<-1, -1>>;
using WritableStageWeights = nb::ndarray<float, nb::shape<-1, -1, -1>, nb::c_contig, nb::device::cpu>;

template <class Images>
monoloc::ImageShape image_shape(const Images& images) {
  return {images.shape(1), images.shape(2), images.shape(3)};
}

template <class T>
void max_pool(const Images<T>& values, std::size_t threads, const WritableImages<T>& largest,
              const WritableImages<std::uint16_t>& from) {
  require_same_shape(values, largest, "values and largest must have one shape");
  require_same_shape(values, from, "values and from_ must have one shape");
  require(image_shape(values).pixels() <= monoloc::kMostPooledPixels, "images have too many pixels");
  nb::gil_scoped_release release;
  monoloc::max_pool(values.data(), values.shape(0), image_shape(values), threads, largest.data(), from.data());
}

template <class T>
void max_pool_gradient(const Images<T>& gradient, const Images<std::uint16_t>& from, std::size_t threads,
                       const WritableImages<T>& out) {
  require_same_shape(gradient, from, "gradient and from_ must have one shape");
  require_same_shape(gradient, out, "gradient and out must have one shape");
  nb::gil_scoped_release release;
  monoloc::max_pool_gradient(gradient.data(), from.data(), gradient.shape(0), image_shape(gradient), threads,
                             out.data());
}

// Returns the number of stages.
template <class T>
std::size_t require_stages(const Images<T>& values, const StageWeights& weights) {
  require(weights.shape(0) > 0 && weights.shape(1) == values.shape(3), "weights must be (stages + 1, channels)");
  return weights.shape(0) - 1;
}

template <class T>
void chain_pools(const Images<T>& values, const StageWeights& weights, std::size_t threads,
                 const WritableImages<T>& out) {
  const std::size_t stages = require_stages(values, weights);
  require_same_shape(values, out, "values and out must have one shape");
  nb::gil_scoped_release release;
  monoloc::chain_pools(values.data(), values.shape(0), image_shape(values), weights.data(), stages, threads,
                       out.data());
}

template <class T>
void chain_pools_gradient(const Images<T>& values, const Images<T>& gradient, const StageWeights& weights,
                          std::size_t threads, const WritableImages<T>& out, const WritableStageWeights& of_weights) {
  const std::size_t stages = require_stages(values, weights);
  require_same_shape(values, gradient, "values and gradient must have one shape");
  require_same_shape(values, out, "values and out must have one shape");
  require(of_weights.shape(0) == values.shape(0) && of_weights.shape(1) == weights.shape(0) &&
              of_weights.shape(2) == weights.shape(1),
          "of_weights must be (images, stages + 1, channels)");
  nb::gil_scoped_release release;
  monoloc::chain_pools_gradient(values.data(), gradient.data(), values.shape(0), image_shape(values), weights.data(),
                                stages, threads, out.data(), of_weights.data());
}

// For images of one type of values.
template <class T>
void define_for(nb::module_& m) {
  m.def("max_pool", &max_pool<T>, "values"_a.noconvert(), "threads"_a, "largest"_a.noconvert(),
        "from_"_a.noconvert());
  m.def("max_pool_gradient", &max_pool_gradient<T>, "gradient"_a.noconvert(), "from_"_a.noconvert(), "threads"_a,
        "out"_a.noconvert());
  m.def("chain_pools", &chain_pools<T>, "values"_a.noconvert(), "weights"_a, "threads"_a, "out"_a.noconvert());
  m.def("chain_pools_gradient", &chain_pools_gradient<T>, "values"_a.noconvert(), "gradient"_a.noconvert(),
        "weights"_a, "threads"_a, "out"_a.noconvert(), "of_weights"_a.noconvert());
}

}  // namespace

void define_pooling(nb::module_& m) {
  m.attr("MOST_POOLED_PIXELS") = monoloc::kMostPooledPixels;
  define_for<float>(m);
  define_for<std::uint16_t>(m);
}
