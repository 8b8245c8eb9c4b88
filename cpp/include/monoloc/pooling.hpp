// Max-pooling for training: 5 x 5, stride 1, of bfloat16 images in channels-last layout.
#pragma once

#include <cstddef>
#include <cstdint>

namespace monoloc {

struct ImageShape {
  std::size_t rows, columns, channels;

  std::size_t pixels() const { return rows * columns; }
  std::size_t values() const { return pixels() * channels; }
};

constexpr std::size_t kMostPooledPixels = 65536;  // per image; a pixel index is half of a key

// Maximum over the 5 x 5 pixels around each pixel, per channel, and the index of its pixel (the first of several).
// The arrays have `images` times shape.values() elements; bfloat16 values are given as bits. Negative zeros become
// positive. NaN is not supported.
void max_pool(const std::uint16_t* values, std::size_t images, const ImageShape& shape, std::size_t threads,
              std::uint16_t* largest, std::uint16_t* from);

// Gradient with respect to max_pool's input from that of its output: each goes to the pixel of the maximum.
void max_pool_gradient(const std::uint16_t* gradient, const std::uint16_t* from, std::size_t images,
                       const ImageShape& shape, std::size_t threads, std::uint16_t* out);

}  // namespace monoloc
