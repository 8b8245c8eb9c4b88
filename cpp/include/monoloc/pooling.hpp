// Max-pooling for training: 5 x 5, stride 1, of bfloat16 images whose channels lie side by side.
#pragma once

#include <cstddef>
#include <cstdint>

namespace monoloc {

struct ImageShape {
  std::size_t rows, columns, channels;

  std::size_t pixels() const { return rows * columns; }
  std::size_t values() const { return pixels() * channels; }
};

constexpr std::size_t kMostPooledPixels = 65536;  // of an image: a pixel's number is half a key

// Every pixel's largest value of the 5 x 5 about it, channel by channel, and the number of the pixel that has it, the
// first of several. Arrays of `images` times shape.values(), bfloat16 as its bits; zeros come
// out positive, and NaN is not looked for.
void max_pool(const std::uint16_t* values, std::size_t images, const ImageShape& shape, std::size_t threads,
              std::uint16_t* largest, std::uint16_t* from);

// The gradient by max_pool's input, from that by its output: each goes where the value came from.
void max_pool_gradient(const std::uint16_t* gradient, const std::uint16_t* from, std::size_t images,
                       const ImageShape& shape, std::size_t threads, std::uint16_t* out);

}  // namespace monoloc
