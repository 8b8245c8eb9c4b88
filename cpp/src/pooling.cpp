#include "monoloc/pooling.hpp"

#include <algorithm>
#include <cstring>
#include <vector>

#include "monoloc/kernels.hpp"
#include "pool.hpp"

namespace monoloc {
namespace {

float to_float(float value) { return value; }

float to_float(std::uint16_t bits) {
  const std::uint32_t wide = static_cast<std::uint32_t>(bits) << 16;
  float value;
  std::memcpy(&value, &wide, sizeof value);
  return value;
}

void convert(float value, float& out) { out = value; }

// The number of a pixel.
void convert(std::int32_t value, std::uint16_t& out) { out = static_cast<std::uint16_t>(value); }

// Rounds to nearest, ties to even.
void convert(float value, std::uint16_t& out) {
  std::uint32_t wide;
  std::memcpy(&wide, &value, sizeof wide);
  out = static_cast<std::uint16_t>((wide + 0x7FFFu + ((wide >> 16) & 1u)) >> 16);
}

// Up to kPoolLanes channels of an image: its first value, and how many channels there are.
struct Block {
  std::size_t start, first, lanes;
};

// Calls for_block(block) for all channels of an image.
template <class Task>
void for_blocks(std::size_t image, const ImageShape& shape, const Task& for_block) {
  for (std::size_t first = 0; first < shape.channels; first += kPoolLanes) {
    for_block(Block{image * shape.values() + first, first, std::min(kPoolLanes, shape.channels - first)});
  }
}

// All lanes of a pixel are moved where there are as many channels, in a loop of fixed length.
template <class T>
void read(const T* images, const Block& block, const ImageShape& shape, std::vector<float>& out) {
  for (std::size_t pixel = 0; pixel < shape.pixels(); ++pixel) {
    const T* from = images + block.start + pixel * shape.channels;
    float* to = out.data() + pixel * kPoolLanes;
    if (block.lanes == kPoolLanes) {
      for (std::size_t lane = 0; lane < kPoolLanes; ++lane) to[lane] = to_float(from[lane]);
    } else {
      for (std::size_t lane = 0; lane < block.lanes; ++lane) to[lane] = to_float(from[lane]);
    }
  }
}

template <class From, class To>
void write(const std::vector<From>& values, const Block& block, const ImageShape& shape, To* images) {
  for (std::size_t pixel = 0; pixel < shape.pixels(); ++pixel) {
    const From* from = values.data() + pixel * kPoolLanes;
    To* to = images + block.start + pixel * shape.channels;
    if (block.lanes == kPoolLanes) {
      for (std::size_t lane = 0; lane < kPoolLanes; ++lane) convert(from[lane], to[lane]);
    } else {
      for (std::size_t lane = 0; lane < block.lanes; ++lane) convert(from[lane], to[lane]);
    }
  }
}

// The block's columns of weights, (stages + 1, channels).
void read_weights(const float* weights, const Block& block, const ImageShape& shape, std::vector<float>& out) {
  for (std::size_t stage = 0; stage * kPoolLanes < out.size(); ++stage) {
    std::copy_n(weights + stage * shape.channels + block.first, block.lanes, out.data() + stage * kPoolLanes);
  }
}

}  // namespace

template <class T>
void max_pool(const T* values, std::size_t images, const ImageShape& shape, std::size_t threads, T* largest,
              std::uint16_t* from) {
  run_on_threads(images, threads, [&](std::size_t image) {
    const std::size_t size = shape.pixels() * kPoolLanes;
    std::vector<float> given(size), most(size), along(size);
    std::vector<std::int32_t> place(size), along_from(size);
    for_blocks(image, shape, [&](const Block& block) {
      read(values, block, shape, given);
      kernels().pool_block(given.data(), shape.rows, shape.columns, most.data(), place.data(), along.data(),
                           along_from.data());
      write(most, block, shape, largest);
      write(place, block, shape, from);
    });
  });
}

template <class T>
void max_pool_gradient(const T* gradient, const std::uint16_t* from, std::size_t images, const ImageShape& shape,
                       std::size_t threads, T* out) {
  run_on_threads(images, threads, [&](std::size_t image) {
    const std::size_t at = image * shape.values();
    std::vector<float> sums(shape.values(), 0.0f);
    for (std::size_t pixel = 0; pixel < shape.pixels(); ++pixel) {
      for (std::size_t c = 0; c < shape.channels; ++c) {
        const std::size_t i = at + pixel * shape.channels + c;
        sums[from[i] * shape.channels + c] += to_float(gradient[i]);
      }
    }
    for (std::size_t i = 0; i < sums.size(); ++i) convert(sums[i], out[at + i]);
  });
}

template <class T>
void chain_pools(const T* values, std::size_t images, const ImageShape& shape, const float* weights,
                 std::size_t stages, std::size_t threads, T* out) {
  run_on_threads(images, threads, [&](std::size_t image) {
    const std::size_t size = shape.pixels() * kPoolLanes;
    std::vector<float> given(size), chained(size), scratch(3 * size), w((stages + 1) * kPoolLanes);
    for_blocks(image, shape, [&](const Block& block) {
      read(values, block, shape, given);
      read_weights(weights, block, shape, w);
      kernels().chain_block(given.data(), shape.rows, shape.columns, w.data(), stages, scratch.data(),
                            chained.data());
      write(chained, block, shape, out);
    });
  });
}

template <class T>
void chain_pools_gradient(const T* values, const T* gradient, std::size_t images, const ImageShape& shape,
                          const float* weights, std::size_t stages, std::size_t threads, T* out, float* of_weights) {
  run_on_threads(images, threads, [&](std::size_t image) {
    const std::size_t size = shape.pixels() * kPoolLanes;
    std::vector<float> given(size), of_chain(size), of_given(size), scratch((4 + stages) * size);
    std::vector<float> w((stages + 1) * kPoolLanes), of_w(w.size());
    std::vector<std::int32_t> places((1 + stages) * size);
    for_blocks(image, shape, [&](const Block& block) {
      read(values, block, shape, given);
      read(gradient, block, shape, of_chain);
      read_weights(weights, block, shape, w);
      kernels().chain_gradient_block(given.data(), of_chain.data(), shape.rows, shape.columns, w.data(), stages,
                                     scratch.data(), places.data(), of_given.data(), of_w.data());
      write(of_given, block, shape, out);
      float* to = of_weights + image * (stages + 1) * shape.channels + block.first;
      for (std::size_t stage = 0; stage <= stages; ++stage) {
        std::copy_n(of_w.data() + stage * kPoolLanes, block.lanes, to + stage * shape.channels);
      }
    });
  });
}

#define MONOLOC_POOLING(T)                                                                                            \
  template void max_pool(const T*, std::size_t, const ImageShape&, std::size_t, T*, std::uint16_t*);                  \
  template void max_pool_gradient(const T*, const std::uint16_t*, std::size_t, const ImageShape&, std::size_t, T*);   \
  template void chain_pools(const T*, std::size_t, const ImageShape&, const float*, std::size_t, std::size_t, T*);    \
  template void chain_pools_gradient(const T*, const T*, std::size_t, const ImageShape&, const float*, std::size_t,   \
                                     std::size_t, T*, float*);
MONOLOC_POOLING(float)
MONOLOC_POOLING(std::uint16_t)
#undef MONOLOC_POOLING

}  // namespace monoloc
