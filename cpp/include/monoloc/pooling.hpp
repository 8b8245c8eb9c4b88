// Max-pooling for training: 5 x 5, stride 1, of images in channels-last layout. Values are float, or bits of bfloat16
// (std::uint16_t), computed with in float.
#pragma once

#include <cstddef>
#include <cstdint>

namespace monoloc {

struct ImageShape {
  std::size_t rows, columns, channels;

  std::size_t pixels() const { return rows * columns; }
  std::size_t values() const { return pixels() * channels; }
};

constexpr std::size_t kMostPooledPixels = 65536;  // per image, for the type of their numbers

// Maximum over the 5 x 5 pixels around each pixel, per channel, and the number of its pixel (the first of several). The
// arrays have `images` times shape.values() elements. NaN is not supported.
template <class T>
void max_pool(const T* values, std::size_t images, const ImageShape& shape, std::size_t threads, T* largest,
              std::uint16_t* from);

// Gradient with respect to max_pool's input from that of its output: each goes to the pixel of the maximum.
template <class T>
void max_pool_gradient(const T* gradient, const std::uint16_t* from, std::size_t images, const ImageShape& shape,
                       std::size_t threads, T* out);

// Chained residual pooling with one weight per stage and channel: relu6(w_n (x + p_1 + ... + p_n)), with
// p_0 = x and p_(i+1) = w_i max_pool(p_i). weights: (stages + 1, channels).
template <class T>
void chain_pools(const T* values, std::size_t images, const ImageShape& shape, const float* weights,
                 std::size_t stages, std::size_t threads, T* out);

// Gradients with respect to chain_pools' values and weights from that of its output, of each image its own:
// of_weights is (images, stages + 1, channels).
template <class T>
void chain_pools_gradient(const T* values, const T* gradient, std::size_t images, const ImageShape& shape,
                          const float* weights, std::size_t stages, std::size_t threads, T* out, float* of_weights);

}  // namespace monoloc
